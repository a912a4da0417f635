//! NumPy's archives; what begins as an array is put into one first.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::io::Cursor;
use tid3r::exchange::npz::{Header, NpzReader};
use tid3r_fuzz::{heard, stored_zip};

/// A reader tells values to whoever wants them; nobody wants more.
const MOST_VALUES: usize = 1 << 22;

fuzz_target!(|data: &[u8]| {
    let wrapped;
    let archive = if data.starts_with(b"\x93NUMPY") {
        let _ = Header::read(&mut &*data);
        wrapped = stored_zip(&[("depths.npy", data)]);
        &*wrapped
    } else {
        data
    };
    let Ok(mut npz) = NpzReader::new(Cursor::new(archive)) else {
        return;
    };
    for name in ["depths", "poses", "intrinsics"] {
        if let Some(array) = heard(npz.array(name)) {
            let count = array.header.shape.iter().product::<usize>();
            if count <= MOST_VALUES {
                heard(array.read(|place, _| assert!(place < count)));
            }
        }
    }
});
