//! LPIPS, whose weights are in two files.

#![allow(clippy::unwrap_used)] // the helpers, not only the tests

mod common;

use std::fs;
use std::path::PathBuf;

use common::{Tensor, quietly, safetensors, state_dict, stored, tiny, torch_legacy, torch_zip};
use tid3r_weights_convert::{ConvertOptions, Found, Written, verify};

/// The classifier as torchvision publishes it, with layers that are not used; and the heads.
fn halves(name: &str) -> (Vec<Tensor>, Vec<Tensor>) {
    let is_head = |tensor: &Tensor| tensor.name.starts_with("lin");
    let (heads, mut classifier): (Vec<_>, Vec<_>) = tiny(name, 3).into_iter().partition(is_head);
    classifier.push(Tensor::f32("classifier.6.bias", &[2], &[1.0, 2.0]));
    (classifier, heads)
}

fn archive(tensors: &[Tensor]) -> Vec<u8> {
    torch_zip("archive", &state_dict(tensors), tensors)
}

struct Place(tempfile::TempDir);

impl Place {
    fn with(files: &[(&str, Vec<u8>)]) -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        for (name, bytes) in files {
            fs::write(place.path(name), bytes).unwrap();
        }
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn convert(&self, source: &str, with: &[&str]) -> Result<Written, String> {
        let with: Vec<_> = with.iter().map(|name| self.path(name)).collect();
        let options = ConvertOptions {
            with: &with,
            replace: true,
            ..ConvertOptions::default()
        };
        quietly(&self.path(source), &self.path("out"), &options)
    }
}

#[test]
fn classifier_and_heads_become_one_file() {
    for name in ["lpips-alex", "lpips-vgg"] {
        let (classifier, heads) = halves(name);
        // As they are published: the heads by an older PyTorch.
        let place = Place::with(&[
            ("classifier.pth", archive(&classifier)),
            ("heads.pth", torch_legacy(&heads)),
        ]);
        let written = place.convert("classifier.pth", &["heads.pth"]).unwrap();
        assert_eq!(written.network, name);
        assert_eq!(written.provenance.source, "classifier.pth + heads.pth");
        let found = Found::at(&place.path("out")).unwrap();
        assert!(verify(&found, &mut |_| ()).unwrap().ok);
        let values = stored(&place.path("out"));
        assert_eq!(values.len(), tiny(name, 3).len());
        for tensor in tiny(name, 3) {
            assert_eq!(values[&tensor.name].1, tensor.bytes, "{}", tensor.name);
        }
        // The other way round, and once more from what was made.
        let back = place.convert("heads.pth", &["classifier.pth"]).unwrap();
        assert_eq!(back.tensors, written.tensors);
        fs::rename(place.path("out"), place.path("ours")).unwrap();
        let again = place.convert("ours/model.safetensors", &[]).unwrap();
        assert_eq!(again.sha256, back.sha256);
    }
}

#[test]
fn a_whole_lpips_is_read_too() {
    // The package's own names: slices, and each head once more in a list.
    let slice = |layer: usize| 1 + [2, 5, 8, 10].iter().filter(|&&end| layer >= end).count();
    let mut tensors = vec![Tensor::f32("scaling_layer.shift", &[1], &[0.0])];
    for tensor in tiny("lpips-alex", 5) {
        let named = |name: String| Tensor {
            name,
            ..tensor.clone()
        };
        match tensor.name.strip_prefix("features.") {
            Some(rest) => {
                let layer = rest.split('.').next().unwrap().parse().unwrap();
                tensors.push(named(format!("net.slice{}.{rest}", slice(layer))));
            }
            None => {
                tensors.push(named(tensor.name.clone()));
                tensors.push(named(tensor.name.replace("lin", "lins.")));
            }
        }
    }
    let place = Place::with(&[("whole.safetensors", safetensors(&tensors))]);
    place.convert("whole.safetensors", &[]).unwrap();
    for (name, (_, bytes)) in stored(&place.path("out")) {
        let tiny = tiny("lpips-alex", 5);
        assert_eq!(bytes, tiny.iter().find(|t| t.name == name).unwrap().bytes);
    }
}

#[test]
fn halves_and_what_does_not_fit_are_refused() {
    let (alex, alex_heads) = halves("lpips-alex");
    let (vgg, _) = halves("lpips-vgg");
    let place = Place::with(&[
        ("alex.pth", archive(&alex)),
        ("heads.pth", archive(&alex_heads)),
        ("vgg.pth", archive(&vgg)),
    ]);
    for (source, with, reason) in [
        (
            "alex.pth",
            &[][..],
            "give the heads of LPIPS, too: --with alex.pth",
        ),
        ("heads.pth", &[], "give the classifier's checkpoint first"),
        (
            "vgg.pth",
            &["heads.pth"],
            "not a checkpoint of LPIPS 0.1 on VGG16: of another shape",
        ),
        (
            "alex.pth",
            &["vgg.pth"],
            "give files that complete each other",
        ),
        ("alex.pth", &["nowhere.pth"], "nowhere.pth"),
    ] {
        let message = place.convert(source, with).unwrap_err();
        assert!(message.contains(reason), "{reason}: {message}");
    }
}
