//! A reader: frames and messages by hand, tables by Arrow's own.

use crate::exchange::rrd::stream::kind;
use arrow_array::{
    Array, ArrayRef, RecordBatch,
    cast::AsArray,
    types::{Float32Type, UInt8Type},
};
use arrow_ipc::reader::StreamReader;
use std::{collections::BTreeMap, io::Cursor};

/// The fields of a message: numbers as eight bytes.
pub(super) fn fields(mut bytes: &[u8]) -> BTreeMap<u64, Vec<u8>> {
    fn varint(bytes: &mut &[u8]) -> u64 {
        let length = bytes.iter().position(|byte| *byte < 0x80).unwrap() + 1;
        let (number, rest) = bytes.split_at(length);
        *bytes = rest;
        let digits = number.iter().rev();
        digits.fold(0, |value, byte| value << 7 | u64::from(byte & 0x7f))
    }
    let mut fields = BTreeMap::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        let value = match key & 7 {
            0 => varint(&mut bytes).to_le_bytes().to_vec(),
            wire => {
                let length = if wire == 1 {
                    8
                } else {
                    varint(&mut bytes) as usize
                };
                let (value, rest) = bytes.split_at(length);
                bytes = rest;
                value.to_vec()
            }
        };
        assert!(fields.insert(key >> 3, value).is_none());
    }
    fields
}

pub(super) fn number(bytes: &[u8]) -> u64 {
    u64::from_le_bytes(bytes.try_into().unwrap())
}

/// The kind, the place and the bytes of each message.
pub(super) fn messages(file: &[u8]) -> Vec<(u64, usize, &[u8])> {
    assert_eq!(&file[..12], b"RRF2\x00\x1c\x02\x00\x01\x02\x00\x00");
    let mut at = 12;
    let mut messages: Vec<(u64, usize, &[u8])> = Vec::new();
    while messages.last().is_none_or(|&(last, ..)| last != kind::END) {
        let size = number(&file[at + 8..at + 16]) as usize;
        let message = (
            number(&file[at..at + 8]),
            at + 16,
            &file[at + 16..at + 16 + size],
        );
        messages.push(message);
        at += 16 + size;
    }
    assert_eq!(file.len() - at, 32, "then there is a frame");
    messages
}

pub(super) fn table(bytes: &[u8]) -> RecordBatch {
    let mut reader = StreamReader::try_new(Cursor::new(bytes), None).unwrap();
    let batch = reader.next().unwrap().unwrap();
    assert!(reader.next().is_none());
    batch
}

/// The tables of a file, by entity.
pub(super) fn tables(file: &[u8]) -> BTreeMap<String, RecordBatch> {
    let messages = messages(file);
    let messages = messages.iter().filter(|(kind, ..)| *kind == kind::TABLE);
    let table_of = |&(_, _, message): &(u64, usize, &[u8])| {
        let fields = fields(message);
        assert_eq!(
            (
                number(&fields[&2]),
                number(&fields[&4]),
                number(&fields[&7])
            ),
            (2, 1, 1)
        );
        let size = number(&fields[&3]) as usize;
        let table = table(&lz4_flex::block::decompress(&fields[&5], size).unwrap());
        (
            table.schema().metadata()["rerun:entity_path"].clone(),
            table,
        )
    };
    messages.map(table_of).collect()
}

/// The values of a component, which must be of this type.
pub(super) fn values(table: &RecordBatch, name: &str, component: &str) -> ArrayRef {
    let schema = table.schema();
    let field = schema.field_with_name(name).unwrap();
    let wanted = [
        (
            "rerun:archetype",
            format!("rerun.archetypes.{}", name.split(':').next().unwrap()),
        ),
        ("rerun:component", name.into()),
        (
            "rerun:component_type",
            format!("rerun.components.{component}"),
        ),
        ("rerun:kind", "data".into()),
    ];
    assert_eq!(
        *field.metadata(),
        wanted.map(|(k, v)| (k.to_owned(), v)).into()
    );
    let column = table.column_by_name(name).unwrap().as_list::<i32>().clone();
    assert_eq!(column.len(), 1);
    column.value(0)
}

pub(super) fn floats(table: &RecordBatch, name: &str, component: &str) -> Vec<f32> {
    let values = values(table, name, component);
    let numbers = values.as_fixed_size_list().values().clone();
    numbers.as_primitive::<Float32Type>().values().to_vec()
}

pub(super) fn bytes(array: &ArrayRef) -> Vec<u8> {
    array.as_primitive::<UInt8Type>().values().to_vec()
}
