//! Every command in the documents is one that the program understands.

use crate::Place;
use std::{fs, path::Path};

/// The commands in the blocks of shell in a document: arguments of tid3r, one command each.
fn commands(document: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(document)).unwrap();
    let mut inside = false;
    let mut found = Vec::new();
    for line in text.lines() {
        if line.starts_with("```") {
            inside = line == "```sh";
        } else if inside && let Some(arguments) = line.strip_prefix("tid3r ") {
            found.push(words(arguments));
        }
    }
    found
}

/// Words as a shell divides them: quotes join, comments and what follows a pipe or redirection do not count.
fn words(text: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut word: Option<String> = None;
    let mut quoted = false;
    for character in text.chars() {
        match character {
            '\'' => {
                quoted = !quoted;
                word.get_or_insert_default();
            }
            ' ' if !quoted => words.extend(word.take()),
            '#' | '|' | '>' if !quoted && word.is_none() => return words,
            other => word.get_or_insert_default().push(other),
        }
    }
    words.extend(word);
    words
}

#[test]
fn words_are_those_of_a_shell() {
    assert_eq!(words("a 'b c' --to '#12' # d"), ["a", "b c", "--to", "#12"]);
    assert_eq!(words("man | man -l -"), ["man"]);
    assert_eq!(words("x > y"), ["x"]);
}

#[test]
fn documented_commands_are_understood() {
    let place = Place::new();
    for (document, least) in [("README.md", 60), ("docs/GUIDE.md", 25)] {
        let commands = commands(document);
        assert!(commands.len() >= least, "{document}: {}", commands.len());
        for mut arguments in commands {
            // What is wrong with arguments is said before any help.
            arguments.push("--help".into());
            let output = place.output_of(&arguments);
            let error = String::from_utf8_lossy(&output.stderr);
            assert_eq!(
                output.status.code(),
                Some(0),
                "{document}: {arguments:?}: {error}"
            );
        }
    }
}
