//! What is known of the networks without any file.

use std::fmt::Write as _;
use std::path::Path;

use sha2::{Digest, Sha256};
use tid3r_weights_convert::{
    Config, ConfigFile, ConvertOptions, Found, Network, Precision, synthesize, verify,
};

use crate::common::{quietly, stored, tiny};
use crate::{NETWORKS, PLAIN, named};

/// The hashes are of the names and shapes that the original modules have at full size.
#[test]
fn the_networks_have_the_tensors_of_the_originals() {
    for (name, tensors, hash) in [
        (
            "see3d-sparse",
            686,
            "f7bbe5ac2a73d1db5e50a2ac80adf01076141c07d6faf1e276e18c6195f8f23f",
        ),
        (
            "see3d-vae",
            248,
            "a3750584b623416871c0bf1adb0e67eb2ae5db49b3fe04453382b64fa88e3a6a",
        ),
        (
            "see3d-image-encoder",
            520,
            "41971828e2e6ad614d235e700cbc2d4bf09bec2eef7c38fbf459c64c7fd6d6b4",
        ),
        (
            "see3d-text-encoder",
            372,
            "0e6fa40937d0465bd8f80f80fd0ab2b801c5b9e9ee5431a11bf6e319fafda524",
        ),
    ] {
        let network = named(name);
        let shapes = network.released().tensors().unwrap();
        assert_eq!(shapes.len(), tensors, "{name}");
        let numbers = shapes.values().map(|shape| shape.iter().product::<usize>());
        assert_eq!(numbers.sum::<usize>() as u64, network.parameters, "{name}");
        let mut all = Sha256::new();
        for (name, shape) in &shapes {
            let sizes: Vec<_> = shape.iter().map(usize::to_string).collect();
            all.update(format!("{name} {}\n", sizes.join(",")));
        }
        let mut found = String::new();
        for byte in all.finalize() {
            write!(found, "{byte:02x}").unwrap();
        }
        assert_eq!(found, hash, "{name}");
    }
    for name in ["see3d-single", "see3d-super-resolution"] {
        let [sparse, other] = [named("see3d-sparse"), named(name)];
        assert_eq!(other.parameters, sparse.parameters);
        assert_eq!(other.released().tensors(), sparse.released().tensors());
        assert_eq!(other.released().network(), other);
    }
}

#[test]
fn the_encoders_say_what_the_unets_listen_to() {
    for of in [Network::released, Network::tiny] {
        let [Config::TextEncoder(text), Config::ImageEncoder(image)] =
            ["see3d-text-encoder", "see3d-image-encoder"].map(|name| of(named(name)))
        else {
            panic!();
        };
        for name in ["see3d-sparse", "see3d-single", "see3d-super-resolution"] {
            let Config::Unet(unet) = of(named(name)) else {
                panic!();
            };
            assert_eq!(unet.unet.context_dim, text.text.hidden_size);
            assert_eq!(unet.unet.context_dim, image.vision.projection_dim);
        }
        assert_eq!(image.preprocessor.crop, [image.vision.image_size; 2]);
        assert_eq!(text.empty_prompt.len(), 77);
        let vocabulary = text.text.vocab_size as u32;
        assert_eq!(text.empty_prompt[..3], [vocabulary - 2, vocabulary - 1, 0]);
    }
}

#[test]
fn tiny_networks_are_made_and_converted_again() {
    for (name, _) in NETWORKS {
        let place = tempfile::tempdir().unwrap();
        let [made, again] = ["made", "again"].map(|folder| place.path().join(folder));
        let network = named(name);
        let make = |folder: &Path, precision| {
            synthesize(network.tiny(), 7, precision, folder, false, &mut |_| ()).unwrap()
        };
        let written = make(&made, Precision::F32);
        assert_eq!(written.network, name);
        assert!(written.bytes < 8_000_000, "{name}: {}", written.bytes);
        assert!(verify(&Found::at(&made).unwrap(), &mut |_| ()).unwrap().ok);
        for tensor in tiny(name, 7) {
            assert!(
                stored(&made)[&tensor.name].1 == tensor.bytes,
                "{}",
                tensor.name
            );
        }
        let half = ConvertOptions {
            precision: Precision::Bf16,
            ..PLAIN
        };
        // No other file is needed, and no name of a folder.
        let converted = quietly(&made, &again, &half).unwrap();
        assert_eq!((converted.network, &converted.notes[..]), (name, &[][..]));
        let file = ConfigFile::read(&again.join("config.json")).unwrap();
        assert_eq!(file.config, network.tiny());
        let direct = make(&place.path().join("bf16"), Precision::Bf16);
        assert_eq!(converted.sha256, direct.sha256);
    }
}

#[test]
fn names_stand_for_one_network_or_for_those_of_a_method() {
    let names = |name: &str| {
        let networks = Network::all_named(name).map_err(|e| e.to_string());
        networks.map(|networks| networks.iter().map(|n| n.name).collect::<Vec<_>>())
    };
    assert_eq!(names("see3d").unwrap(), NETWORKS.map(|(name, _)| name));
    assert_eq!(names("mobilesamv2").unwrap().len(), 5);
    assert_eq!(names("see3d-vae").unwrap(), ["see3d-vae"]);
    assert_eq!(names("mvdust3r").unwrap(), ["mvdust3r"]);
    for name in ["", "see", "see3d-", "nothing"] {
        assert!(names(name).unwrap_err().contains("see3d-vae"), "{name}");
    }
}
