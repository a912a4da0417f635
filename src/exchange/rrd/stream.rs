//! The stream: a header, messages with their lengths, a footer.

use super::{
    APPLICATION, Entity, Rrd,
    arrays::list,
    columns::{self, Column},
    ids::{Tuid, entity_path},
    manifest::{Manifest, Place},
    protobuf::Message,
};
use arrow_array::{ArrayRef, FixedSizeBinaryArray, RecordBatch};
use arrow_ipc::writer::StreamWriter;
use arrow_schema::{ArrowError, DataType, Field, Schema};
use std::{
    collections::HashMap,
    io::{self, Write},
    sync::Arc,
};
use twox_hash::XxHash32;

/// How files begin, and the frame at their end.
pub(super) const MAGIC: [u8; 4] = *b"RRF2";
/// The version of Rerun whose layout this is: 0.28.2.
const VERSION: [u8; 4] = [0, 28, 2, 0];
/// The version of tables in it.
const TABLE_VERSION: &str = "0.1.2";
/// Tables are compressed by LZ4; messages are Protocol Buffers.
const OPTIONS: [u8; 4] = [1, 2, 0, 0];
/// How checksums start.
pub(super) const CHECKSUM_SEED: u32 = 7_850_921;

/// Kinds of messages.
pub(super) mod kind {
    pub(in super::super) const END: u64 = 0;
    pub(in super::super) const SET_STORE_INFO: u64 = 1;
    pub(in super::super) const TABLE: u64 = 2;
}

/// The column that every table begins with.
pub(super) const ROW_ID: &str = "rerun.controls.RowId";

pub(super) fn write(out: &mut dyn Write, rrd: &Rrd) -> io::Result<()> {
    let mut stream = Stream { out, written: 0 };
    stream.bytes(&MAGIC)?;
    stream.bytes(&VERSION)?;
    stream.bytes(&OPTIONS)?;
    let store = store_id(&rrd.id);
    let mut ids = Tuid::all(&rrd.id);
    let mut id = || {
        ids.next()
            .ok_or_else(|| io::Error::other("ids are endless"))
    };
    stream.message(kind::SET_STORE_INFO, &store_info(id()?, &store))?;

    let mut manifest = Manifest::default();
    let mut table = |stream: &mut Stream, path: String, columns: Vec<Column>| -> io::Result<()> {
        let (chunk, row) = (id()?, id()?);
        let table = table(&path, chunk, row, &columns).map_err(io::Error::other)?;
        let start = stream.written + HEADER_SIZE;
        let message = table_message(&store, chunk, &table);
        stream.message(kind::TABLE, &message)?;
        let place = Place {
            start,
            size: message.len() as u64,
            unpacked: table.len() as u64,
        };
        manifest.add(path, chunk, place, columns);
        Ok(())
    };
    let info = columns::recording_info(&rrd.name);
    table(&mut stream, "/__properties".into(), vec![info])?;
    for Entity { path, contents } in &rrd.entities {
        let parts = contents.iter().map(columns::columns);
        let parts: Vec<Vec<Column>> = parts.collect::<Result<_, _>>().map_err(io::Error::other)?;
        table(
            &mut stream,
            entity_path(path),
            parts.into_iter().flatten().collect(),
        )?;
    }

    let footer = manifest.message(&store).map_err(io::Error::other)?;
    let start = stream.written + HEADER_SIZE;
    stream.message(kind::END, &footer)?;
    stream.bytes(&start.to_le_bytes())?;
    stream.bytes(&(footer.len() as u64).to_le_bytes())?;
    stream.bytes(&XxHash32::oneshot(CHECKSUM_SEED, &footer).to_le_bytes())?;
    stream.bytes(&MAGIC)?;
    stream.bytes(b"FOOT")?;
    stream.bytes(&1_u32.to_le_bytes())
}

/// Bytes of a message's header: kind and length.
const HEADER_SIZE: u64 = 16;

/// Counts what is written.
struct Stream<'a> {
    out: &'a mut dyn Write,
    written: u64,
}

impl Stream<'_> {
    fn bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.written += bytes.len() as u64;
        self.out.write_all(bytes)
    }

    fn message(&mut self, kind: u64, message: &[u8]) -> io::Result<()> {
        self.bytes(&kind.to_le_bytes())?;
        self.bytes(&(message.len() as u64).to_le_bytes())?;
        self.bytes(message)
    }
}

fn store_id(recording: &str) -> Message {
    const RECORDING: u64 = 1;
    let application = Message::default().bytes(1, APPLICATION.as_bytes());
    Message::default()
        .number(1, RECORDING)
        .bytes(2, recording.as_bytes())
        .message(3, &application)
}

fn store_info(row: Tuid, store: &Message) -> Vec<u8> {
    const OTHER: u64 = 6;
    let generator = concat!("tid3r ", env!("CARGO_PKG_VERSION"));
    let extra = Message::default().bytes(1, generator.as_bytes());
    let source = Message::default().number(1, OTHER).message(2, &extra);
    let info = Message::default().message(2, store).message(5, &source);
    let message = Message::default().message(1, &row.message());
    message.message(2, &info).finish()
}

fn table_message(store: &Message, chunk: Tuid, table: &[u8]) -> Vec<u8> {
    const LZ4: u64 = 2;
    const ARROW_IPC: u64 = 1;
    Message::default()
        .message(1, store)
        .number(2, LZ4)
        .number(3, table.len() as u64)
        .number(4, ARROW_IPC)
        .bytes(5, &lz4_flex::block::compress(table))
        .message(6, &chunk.message())
        .number(7, u64::from(true))
        .finish()
}

/// An entity's components: a table of one row, in Arrow's streaming format.
fn table(path: &str, chunk: Tuid, row: Tuid, columns: &[Column]) -> Result<Vec<u8>, ArrowError> {
    let mut fields = vec![row_id_field(&[("rerun:is_sorted", "true")])];
    let ids = FixedSizeBinaryArray::try_from_iter([row.bytes()].iter())?;
    let mut arrays: Vec<ArrayRef> = vec![Arc::new(ids)];
    for column in columns {
        let mut metadata = column.metadata();
        metadata.insert("rerun:kind".into(), "data".into());
        let field = Field::new(column.name(), column.row_type(), true);
        fields.push(field.with_metadata(metadata));
        arrays.push(Arc::new(list(Arc::clone(&column.values), true)?));
    }
    let metadata = owned(&[
        ("rerun:entity_path", path),
        ("rerun:id", &chunk.of_chunk()),
        ("sorbet:version", TABLE_VERSION),
    ]);
    let schema = Schema::new_with_metadata(fields, metadata);
    encoded(&RecordBatch::try_new(Arc::new(schema), arrays)?)
}

/// The column of row ids.
pub(super) fn row_id_field(more: &[(&str, &str)]) -> Field {
    let mut metadata = owned(&[
        ("ARROW:extension:name", "rerun.datatypes.TUID"),
        ("ARROW:extension:metadata", r#"{"namespace":"row"}"#),
        ("rerun:kind", "control"),
    ]);
    metadata.extend(owned(more));
    Field::new(ROW_ID, DataType::FixedSizeBinary(16), false).with_metadata(metadata)
}

fn owned(pairs: &[(&str, &str)]) -> HashMap<String, String> {
    let pairs = pairs.iter();
    pairs
        .map(|&(key, value)| (key.to_owned(), value.to_owned()))
        .collect()
}

/// A table in Arrow's streaming format.
pub(super) fn encoded(batch: &RecordBatch) -> Result<Vec<u8>, ArrowError> {
    let mut writer = StreamWriter::try_new(Vec::new(), batch.schema_ref())?;
    writer.write(batch)?;
    writer.into_inner()
}
