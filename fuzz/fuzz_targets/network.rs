//! Which network tensors are of, by their names and shapes: lines such as `patch_embed.proj.weight 8 3 4 4`. Their numbers
//! are holes in a file.
#![no_main]

use libfuzzer_sys::{Corpus, fuzz_target};
use serde_json::{Map, Value, json};
use std::fs::{self, File};
use tid3r_fuzz::{heard, prepared, put};
use tid3r_weights_convert::{ConvertOptions, Network, network_of};

/// No file is larger.
const MOST_BYTES: u64 = 1 << 50;

/// Seeds: a small network of each kind, but for those that need files beside them.
fn write_seeds() {
    for network in Network::all()
        .iter()
        .filter(|network| network.folder.is_none())
    {
        let tensors = network.tiny().tensors().expect("a network");
        let line = |(name, shape): (&String, &Vec<usize>)| {
            let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
            format!("{name} {}\n", sizes.join(" "))
        };
        let text: String = tensors.iter().map(line).collect();
        fs::write(prepared("network").join(network.name), text).expect("room for a file");
    }
}

fuzz_target!(init: write_seeds(), |data: &[u8]| -> Corpus {
    let Some((head, bytes)) = str::from_utf8(data).ok().and_then(head_of) else {
        return Corpus::Reject;
    };
    let start = [&(head.len() as u64).to_le_bytes()[..], head.as_bytes()].concat();
    let path = put("model.safetensors", &start);
    let file = File::options().write(true).open(&path).expect("a file");
    file.set_len(start.len() as u64 + bytes).expect("a file with holes");
    let options = ConvertOptions {
        // What no shape of MV-DUSt3R's tells.
        heads: Some((2, 2)),
        ..ConvertOptions::default()
    };
    heard(network_of(&path, &options));
    Corpus::Keep
});

/// The header of a safetensors file, and how many bytes follow it.
fn head_of(text: &str) -> Option<(String, u64)> {
    let (mut head, mut end) = (Map::new(), 0_u64);
    for line in text.lines() {
        let mut words = line.split(' ');
        let name = words.next()?;
        let shape: Vec<u64> = words.map(str::parse).collect::<Result<_, _>>().ok()?;
        let count = shape
            .iter()
            .try_fold(2_u64, |product, &size| product.checked_mul(size))?;
        let begin = end;
        end = begin.checked_add(count).filter(|&end| end <= MOST_BYTES)?;
        let tensor = json!({ "dtype": "F16", "shape": shape, "data_offsets": [begin, end] });
        head.insert(name.into(), tensor);
    }
    // Of two lines with one name, the last counts, and leaves a gap.
    Some((Value::Object(head).to_string(), end))
}
