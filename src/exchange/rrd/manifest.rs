//! The footer: which tables there are, where, and of which components, so that they can be read one by one.

use super::{
    columns::Column,
    ids::Tuid,
    protobuf::Message,
    stream::{encoded, row_id_field},
};
use arrow_array::{
    ArrayRef, BooleanArray, FixedSizeBinaryArray, RecordBatch, StringArray, UInt64Array,
};
use arrow_ipc::writer::StreamWriter;
use arrow_schema::{ArrowError, DataType, Field, Schema};
use sha2::{Digest, Sha256};
use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
};

/// Where a table's message lies in the file, without its header.
pub(super) struct Place {
    pub(super) start: u64,
    pub(super) size: u64,
    /// Bytes of the table itself.
    pub(super) unpacked: u64,
}

/// What is known of the tables written so far.
#[derive(Default)]
pub(super) struct Manifest {
    tables: Vec<(String, Tuid, Place)>,
    /// Each component's metadata, and the tables that have it.
    components: BTreeMap<String, (HashMap<String, String>, Vec<usize>)>,
    /// The columns of all tables in one.
    columns: Vec<Field>,
}

impl Manifest {
    /// One more table, of the entity `path`.
    pub(super) fn add(&mut self, path: String, id: Tuid, place: Place, columns: Vec<Column>) {
        for column in columns {
            let name = column.name();
            let prefix = match path.starts_with("/__properties") {
                true => "property",
                false => &path,
            };
            let mut metadata = column.metadata();
            metadata.extend([
                ("rerun:entity_path".to_owned(), path.clone()),
                ("rerun:is_static".to_owned(), "true".to_owned()),
                ("rerun:kind".to_owned(), "data".to_owned()),
            ]);
            let field = Field::new(format!("{prefix}:{name}"), column.row_type(), true);
            self.columns.push(field.with_metadata(metadata));
            let new = || (column.metadata(), Vec::new());
            let (_, tables) = self.components.entry(name).or_insert_with(new);
            tables.push(self.tables.len());
        }
        self.tables.push((path, id, place));
    }

    /// The message that a file ends with.
    pub(super) fn message(&self, store: &Message) -> Result<Vec<u8>, ArrowError> {
        const STREAMING: u64 = 1;
        let schema = self.schema()?;
        let table = encoded(&self.table()?)?;
        let manifest = Message::default()
            .message(1, store)
            .message(2, &Message::default().bytes(1, &schema))
            .bytes(3, &Sha256::digest(&schema))
            .message(4, &Message::default().number(1, STREAMING).bytes(2, &table));
        Ok(Message::default().message(1, &manifest).finish())
    }

    /// The columns of all tables in order, as a stream of Arrow begins.
    fn schema(&self) -> Result<Vec<u8>, ArrowError> {
        let mut fields = self.columns.clone();
        fields.push(row_id_field(&[]));
        fields.sort();
        let mut bytes = Vec::new();
        StreamWriter::try_new(&mut bytes, &Schema::new(fields))?;
        Ok(bytes)
    }

    /// A row for each table.
    fn table(&self) -> Result<RecordBatch, ArrowError> {
        let rows = &self.tables;
        let counts = |count: fn(&Place) -> u64| -> ArrayRef {
            let counts = rows.iter().map(|(_, _, place)| count(place));
            Arc::new(UInt64Array::from_iter_values(counts))
        };
        let paths = StringArray::from_iter_values(rows.iter().map(|(path, ..)| path));
        let ids = FixedSizeBinaryArray::try_from_iter(rows.iter().map(|(_, id, _)| id.bytes()))?;
        let fixed: [(&str, ArrayRef); 7] = [
            ("chunk_entity_path", Arc::new(paths)),
            ("chunk_id", Arc::new(ids)),
            (
                "chunk_is_static",
                Arc::new(BooleanArray::from(vec![true; rows.len()])),
            ),
            ("chunk_num_rows", counts(|_| 1)),
            ("chunk_byte_offset", counts(|place| place.start)),
            ("chunk_byte_size", counts(|place| place.size)),
            (
                "chunk_byte_size_uncompressed",
                counts(|place| place.unpacked),
            ),
        ];
        let mut fields = Vec::new();
        let mut arrays = Vec::new();
        for (name, array) in fixed {
            fields.push(Field::new(name, array.data_type().clone(), false));
            arrays.push(array);
        }
        for (name, (metadata, tables)) in &self.components {
            let mut metadata = metadata.clone();
            metadata.insert("rerun:index".into(), "rerun:static".into());
            let name = format!("{name}:has_static_data");
            fields.push(Field::new(name, DataType::Boolean, false).with_metadata(metadata));
            let has = (0..rows.len()).map(|row| tables.contains(&row));
            arrays.push(Arc::new(BooleanArray::from(has.collect::<Vec<bool>>())));
        }
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays)
    }
}
