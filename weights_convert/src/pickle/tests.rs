use proptest::prelude::*;

use super::{Node, Pickle};

/// Arguments of a training run, an ordered dictionary with `_metadata`, a tensor: what
/// `pickle.dumps(.., protocol=2)` makes of {'args': Namespace(lr=0.5, n=-1), 'model':
/// OrderedDict(a=1)}, the dictionary with a state.
const SMALL: &[u8] = b"\x80\x02}q\x00(X\x04\x00\x00\x00argsq\x01cargparse\nNamespace\nq\x02)\x81q\x03}q\x04(\
    X\x02\x00\x00\x00lrq\x05G?\xe0\x00\x00\x00\x00\x00\x00X\x01\x00\x00\x00nq\x06J\xff\xff\xff\xffubX\x05\x00\x00\x00modelq\x07\
    ccollections\nOrderedDict\nq\x08)Rq\x09X\x01\x00\x00\x00aq\x0aK\x01s}q\x0bX\x09\x00\x00\x00_metadataq\x0c}q\x0dsbu.";

fn problem(bytes: &[u8]) -> String {
    Pickle::read(bytes).unwrap_err().to_string()
}

#[test]
fn dictionaries_objects_and_their_states() {
    let pickle = Pickle::read(SMALL).unwrap();
    let root = pickle.root();
    assert_eq!(pickle.entries(root).unwrap().len(), 2);
    let args = pickle.entry(root, "args").unwrap();
    assert_eq!(pickle.call(args).unwrap().0, "argparse");
    let state = pickle.state(args).unwrap();
    assert!(matches!(
        pickle.get(pickle.entry(state, "lr").unwrap()),
        Node::Float(0.5)
    ));
    assert!(matches!(
        pickle.get(pickle.entry(state, "n").unwrap()),
        Node::Int(-1)
    ));
    // The state of the ordered dictionary is no entry of it.
    let model = pickle.entry(root, "model").unwrap();
    assert_eq!(pickle.entries(model).unwrap().len(), 1);
    assert!(pickle.entry(model, "_metadata").is_none());
    assert!(
        pickle
            .entry(pickle.state(model).unwrap(), "_metadata")
            .is_some()
    );
}

#[test]
fn protocol_4_says_the_same_in_other_words() {
    // pickle.dumps({'a': [1, 2, (3,)], 'b': b'xy', 'c': {5}}, protocol=4)
    let bytes = b"\x80\x04\x95\x28\x00\x00\x00\x00\x00\x00\x00}\x94(\x8c\x01a\x94]\x94(K\x01K\x02K\x03\x85\x94e\
        \x8c\x01b\x94C\x02xy\x94\x8c\x01c\x94\x8f\x94(K\x05\x90u.";
    let pickle = Pickle::read(bytes).unwrap();
    let a = pickle.entry(pickle.root(), "a").unwrap();
    let Node::List(a) = pickle.get(a) else {
        panic!("{}", pickle.describe(a));
    };
    assert_eq!(a.len(), 3);
    assert!(matches!(pickle.get(a[2]), Node::Tuple(parts) if parts.len() == 1));
    let b = pickle.entry(pickle.root(), "b").unwrap();
    assert!(matches!(pickle.get(b), Node::Bytes(b"xy")));
}

#[test]
fn what_is_referred_to_twice_is_the_same_thing() {
    // An object that is kept before it has a state, as pickles do, in both items of a list.
    let bytes =
        b"\x80\x02]q\x00(cnn\nModule\nq\x01)\x81q\x02}q\x03X\x01\x00\x00\x00nK\x07sbh\x02e.";
    let pickle = Pickle::read(bytes).unwrap();
    let Node::List(parts) = pickle.get(pickle.root()) else {
        panic!("no list");
    };
    assert_eq!(parts[0], parts[1]);
    let state = pickle.state(parts[1]).unwrap();
    assert!(pickle.entry(state, "n").is_some());
}

#[test]
fn objects_with_arguments_by_name() {
    // pickle.dumps of an object whose __getnewargs_ex__ is ((1,), {'a': 2}), protocol 4, with a state.
    let bytes = b"\x80\x04\x8c\x01m\x8c\x01C\x93K\x01\x85}\x8c\x01aK\x02s\x92}\x8c\x01bK\x03sb.";
    let pickle = Pickle::read(bytes).unwrap();
    let (module, name, arguments) = pickle.call(pickle.root()).unwrap();
    assert_eq!((module, name, arguments.len()), ("m", "C", 1));
    let state = pickle.state(pickle.root()).unwrap();
    assert!(pickle.entry(state, "b").is_some());
}

#[test]
fn integers_of_any_length() {
    for (bytes, value) in [
        (&b"\x80\x02\x8a\x00."[..], 0),
        (b"\x80\x02\x8a\x01\xff.", -1),
        (b"\x80\x02\x8a\x02\xff\x00.", 255),
        (
            b"\x80\x02\x8b\x05\x00\x00\x00\x00\x00\x00\x00\x01.",
            1 << 32,
        ),
        (b"\x80\x02M\x01\x02.", 513),
    ] {
        let pickle = Pickle::read(bytes).unwrap();
        assert!(matches!(pickle.get(pickle.root()), Node::Int(n) if *n == value));
    }
    let huge = b"\x80\x02\x8a\x09\x00\x00\x00\x00\x00\x00\x00\x00\x01.";
    let pickle = Pickle::read(huge).unwrap();
    assert!(matches!(pickle.get(pickle.root()), Node::LargeInt(_)));
}

#[test]
fn nothing_is_called() {
    let pickle = Pickle::read(b"\x80\x02cos\nsystem\nX\x04\x00\x00\x00ruin\x85R.").unwrap();
    let (module, name, arguments) = pickle.call(pickle.root()).unwrap();
    assert_eq!((module, name), ("os", "system"));
    assert_eq!(pickle.text(arguments[0]), Some("ruin"));
    assert_eq!(pickle.describe(pickle.root()), "an object of `os.system`");
}

#[test]
fn ordered_dictionaries_of_python_2_are_made_from_a_list() {
    let bytes = b"\x80\x02ccollections\nOrderedDict\n](](U\x01aK\x07e](U\x01bK\x08ee\x85R.";
    let pickle = Pickle::read(bytes).unwrap();
    let value = |key| pickle.entry(pickle.root(), key).map(|id| pickle.get(id));
    assert!(matches!(value("a"), Some(Node::Int(7))));
    assert!(matches!(value("b"), Some(Node::Int(8))));
    assert_eq!(pickle.entries(pickle.root()).unwrap().len(), 2);
}

#[test]
fn a_list_that_holds_itself_is_data() {
    let pickle = Pickle::read(b"\x80\x02]q\x00h\x00a.").unwrap();
    let Node::List(parts) = pickle.get(pickle.root()) else {
        panic!("no list");
    };
    assert_eq!(parts, &[pickle.root()]);
}

#[test]
fn depth_and_repetition_cost_what_the_file_spells_out() {
    let mut deep = b"\x80\x02)".to_vec();
    deep.extend([0x85].repeat(500_000));
    deep.push(b'.');
    drop(Pickle::read(&deep).unwrap());

    // Ten references to a list of ten references to a list ..: 10^60 values if written out.
    let mut laughs = b"\x80\x02]q\x00".to_vec();
    for level in 0..60 {
        laughs.extend(b"](");
        laughs.extend([b'h', level].repeat(10));
        laughs.extend([b'e', b'q', level + 1]);
    }
    laughs.push(b'.');
    assert!(Pickle::read(&laughs).unwrap().nodes.len() < 100);
}

#[test]
fn what_is_no_pickle_is_refused_with_its_reason() {
    for (bytes, reason) in [
        (&b""[..], "cut short"),
        (b"\x80", "cut short"),
        (b"\x80\x02", "cut short"),
        (b"\x80\x00.", "protocol 0"),
        (b"\x80\x09.", "protocol 9"),
        (b"\x80\x02.", "takes more values"),
        (b"\x80\x02(.", "takes more values"),
        (b"\x80\x02N(0.", "takes more values"),
        (b"\x80\x02t.", "a mark that it has not set"),
        (b"\x80\x02(NNNd.", "a key has no value"),
        (b"\x80\x02}Na.", "no list"),
        (b"\x80\x02]NNs.", "no dictionary"),
        (b"\x80\x02NNb.", "no object"),
        (b"\x80\x02(o.", "no class"),
        (b"\x80\x02NN\x93.", "no text for a name"),
        (b"\x80\x02h\x05.", "recalls value 5"),
        (
            b"\x80\x02X\xff\xff\xff\x7fab",
            "2147483647 bytes are announced and 2 are left",
        ),
        (
            b"\x80\x04\x8d\xff\xff\xff\xff\xff\xff\xff\xffab",
            "18446744073709551615",
        ),
        (b"\x80\x02\x8b\xff\xff\xff\xffab", "announced"),
        (b"\x80\x02X\x01\x00\x00\x00\xff.", "not UTF-8"),
        (b"\x80\x02cos\nsystem", "cut short"),
        (b"\x80\x02\x82\x01.", "0x82 is no instruction"),
        (b"\x80\x02I1\n.", "0x49 is no instruction"),
    ] {
        let message = problem(bytes);
        assert!(message.contains(reason), "{bytes:?}: {message}");
    }
    assert!(problem(b"\x80\x02\x82").contains("at byte 2"));
    let endless = b"N0".repeat(3 << 20);
    assert!(problem(&endless).contains("instructions"));
    assert!(problem(&vec![b'N'; 17 << 20]).contains("bytes"));
}

/// Everything that is done with a pickle.
fn look_at(pickle: &Pickle<'_>) {
    for (index, _) in pickle.nodes.iter().enumerate() {
        let id = super::Id(index as u32);
        let _ = (pickle.describe(id), pickle.call(id), pickle.state(id));
        let _ = (
            pickle.entry(id, "model"),
            pickle.entries(id),
            pickle.text(id),
        );
    }
}

proptest! {
    #[test]
    fn no_bytes_bring_it_down(mut bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        if let Ok(pickle) = Pickle::read(&bytes) {
            look_at(&pickle);
        }
        bytes.splice(0..0, *b"\x80\x02");
        if let Ok(pickle) = Pickle::read(&bytes) {
            look_at(&pickle);
        }
    }

    #[test]
    fn no_damage_brings_it_down(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        end in any::<prop::sample::Index>(),
    ) {
        let mut bytes = SMALL.to_vec();
        for (index, byte) in changes {
            let at = index.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok(pickle) = Pickle::read(&bytes) {
            look_at(&pickle);
        }
        let _ = Pickle::read(&bytes[..end.index(bytes.len())]);
    }
}
