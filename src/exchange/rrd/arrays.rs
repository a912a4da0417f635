//! The kinds of Arrow arrays that components are made of. Names of items, and what may be missing, are as
//! Rerun has them.

use arrow_array::{
    Array, ArrayRef, ArrowPrimitiveType, FixedSizeListArray, ListArray, PrimitiveArray,
    StringArray, StructArray, UInt8Array,
};
use arrow_buffer::{OffsetBuffer, ScalarBuffer};
use arrow_schema::{ArrowError, DataType, Field};
use std::sync::Arc;

pub(super) fn structs(fields: Vec<(Field, ArrayRef)>) -> Result<StructArray, ArrowError> {
    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = fields.into_iter().unzip();
    StructArray::try_new(fields.into(), arrays, None)
}

pub(super) fn text(text: &str) -> StringArray {
    StringArray::from(vec![text])
}

pub(super) fn bytes(bytes: Vec<u8>) -> UInt8Array {
    UInt8Array::new(ScalarBuffer::from(bytes), None)
}

/// Lists of N numbers.
pub(super) fn rows<T: ArrowPrimitiveType, const N: usize>(
    rows: &[[T::Native; N]],
) -> Result<FixedSizeListArray, ArrowError> {
    let numbers = PrimitiveArray::<T>::from_iter_values(rows.iter().flatten().copied());
    FixedSizeListArray::try_new(
        item(&T::DATA_TYPE, false),
        N as i32,
        Arc::new(numbers),
        None,
    )
}

/// A list of all that there is.
pub(super) fn one_list(values: impl Array + 'static) -> Result<ListArray, ArrowError> {
    list(Arc::new(values), false)
}

/// One list of `values`; an error if they are more than the 2^31 that Arrow's lists can hold.
pub(super) fn list(values: ArrayRef, nullable: bool) -> Result<ListArray, ArrowError> {
    let length =
        i32::try_from(values.len()).map_err(|_| ArrowError::OffsetOverflowError(values.len()))?;
    let offsets = OffsetBuffer::new(vec![0, length].into());
    ListArray::try_new(item(values.data_type(), nullable), offsets, values, None)
}

pub(super) fn item(data_type: &DataType, nullable: bool) -> Arc<Field> {
    Arc::new(Field::new("item", data_type.clone(), nullable))
}

/// A field with an empty list for each of `count`.
pub(super) fn no_lists(
    name: &str,
    of: &DataType,
    count: usize,
) -> Result<(Field, ArrayRef), ArrowError> {
    let offsets = OffsetBuffer::from_lengths(std::iter::repeat_n(0, count));
    let lists = ListArray::try_new(
        item(of, false),
        offsets,
        arrow_array::new_empty_array(of),
        None,
    )?;
    Ok((
        Field::new(name, lists.data_type().clone(), false),
        Arc::new(lists),
    ))
}
