use super::*;
use std::io::Cursor;

fn archive(npy: &[u8]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default();
    zip.start_file("x.npy", options).unwrap();
    zip.write_all(npy).unwrap();
    zip.finish().unwrap().into_inner()
}

fn npy(header: &Header, values: &[u8]) -> Vec<u8> {
    [header.to_bytes(), values.to_vec()].concat()
}

/// Place and value of every element, sorted by place; or what is wrong.
fn read(archive: &[u8]) -> Result<Vec<(usize, f64)>, String> {
    let mut npz = NpzReader::new(Cursor::new(archive)).unwrap();
    let mut values = Vec::new();
    npz.array("x")?
        .read(|place, value| values.push((place, value)))?;
    values.sort_by_key(|(place, _)| *place);
    Ok(values)
}

#[test]
fn both_orders_and_both_precisions_give_the_same_values() {
    // numpy: arange(12).reshape(2, 3, 2), its memory in either order.
    let last = Vec::from_iter((0..12_u8).map(f64::from));
    let first = [0, 6, 2, 8, 4, 10, 1, 7, 3, 9, 5, 11]
        .map(f64::from)
        .to_vec();
    for (fortran_order, values) in [(false, last), (true, first)] {
        for number in [Number::F32, Number::F64] {
            let header = Header {
                fortran_order,
                ..Header::new(&[2, 3, 2], number)
            };
            let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
            npz.add("x", &header, values.clone()).unwrap();
            let found = read(npz.finish().unwrap().get_ref()).unwrap();
            let wanted = Vec::from_iter((0..12_u8).map(|k| (usize::from(k), f64::from(k))));
            assert_eq!(found, wanted, "{header:?}");
        }
    }
}

#[test]
fn arrays_without_the_values_that_they_need_are_refused() {
    for (shape, bytes) in [
        (&[1, 1, 2][..], 4),
        (&[1 << 32, 1 << 32, 1 << 32], 4),
        (&[100_000, 100_000, 100_000], 4),
        (&[1 << 20], 4),
        (&[0, 1, 1], 4),
        (&[1], 8),
    ] {
        let file = npy(&Header::new(shape, Number::F32), &vec![0; bytes]);
        let message = read(&archive(&file)).unwrap_err();
        assert!(message.contains("does not have the values"), "{message}");
    }
    // A directory that states what the shape needs.
    let header = Header::new(&[16384, 16384], Number::F32);
    let mut lying = archive(&npy(&header, &[0; 4]));
    let directory = lying.windows(4).position(|bytes| bytes == b"PK\x01\x02");
    let sizes = directory.unwrap() + 20;
    let stated = (128 + (1_u32 << 30)).to_le_bytes().repeat(2);
    lying[sizes..sizes + 8].copy_from_slice(&stated);
    let message = read(&lying).unwrap_err();
    assert!(message.contains("does not have the values"), "{message}");
    assert_eq!(
        read(&archive(&npy(&Header::new(&[0, 3], Number::F32), &[]))),
        Ok(vec![])
    );
    let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
    let header = Header::new(&[2], Number::F32);
    assert!(npz.add("x", &header, [1.0]).is_err());
}

#[test]
fn a_damaged_value_is_noticed_and_a_missing_array_named() {
    let header = Header::new(&[1, 1, 2], Number::F32);
    let mut bytes = archive(&npy(&header, &[0; 8]));
    assert!(read(&bytes).is_ok());
    let at = bytes.len() / 2;
    bytes[at - 40..at].fill(0x55);
    assert!(read(&bytes).is_err());
    let bytes = archive(b"");
    let mut npz = NpzReader::new(Cursor::new(&bytes)).unwrap();
    let message = npz.array("depths").err().unwrap();
    assert_eq!(message, "is missing (there are: x)");
}

#[test]
fn every_part_of_an_archive_may_be_damaged() {
    let header = Header::new(&[2, 3], Number::F64);
    let bytes = archive(&npy(&header, &[7; 48]));
    for at in 0..bytes.len() {
        for value in [0, 0x7f, 0xff] {
            let mut damaged = bytes.clone();
            damaged[at] = value;
            if let Ok(mut npz) = NpzReader::new(Cursor::new(&damaged))
                && let Ok(array) = npz.array("x")
            {
                let _ = array.read(|_, _| ());
            }
        }
        let cut = NpzReader::new(Cursor::new(&bytes[..at]));
        if let Ok(Ok(array)) = cut.map(|mut npz| npz.array("x").map(|array| array.header)) {
            assert_eq!(array, header);
        }
    }
}
