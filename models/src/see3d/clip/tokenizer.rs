//! From texts to the numbers of their tokens.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::fs;
use std::path::Path;

use candle_core::{Error, Result};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use tokenizers::models::bpe::{BPE, Vocab};
use tokenizers::normalizers::{BertNormalizer, NFC, Sequence as Normalizers};
use tokenizers::pre_tokenizers::byte_level::ByteLevel;
use tokenizers::pre_tokenizers::sequence::Sequence as Splitters;
use tokenizers::pre_tokenizers::split::{Split, SplitPattern};
use tokenizers::{AddedToken, SplitDelimiterBehavior};

/// CLIP's tokenizer (`CLIPTokenizer`): lower case, words, and byte pairs within them.
#[derive(Clone, Debug)]
pub struct Tokenizer {
    inner: tokenizers::Tokenizer,
    start: u32,
    end: u32,
    padding: u32,
    length: usize,
}

/// `tokenizer_config.json`.
#[derive(Deserialize)]
struct ConfigFile {
    #[serde(flatten)]
    special: SpecialTokens,
    /// A number that means none if it is huge.
    model_max_length: Option<f64>,
    /// Only in files of newer versions, which have all special tokens in this file.
    added_tokens_decoder: Option<BTreeMap<String, serde_json::Value>>,
}

/// Which tokens are special; `special_tokens_map.json`, too.
#[derive(Default, Deserialize)]
struct SpecialTokens {
    bos_token: Option<SpecialToken>,
    eos_token: Option<SpecialToken>,
    pad_token: Option<SpecialToken>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum SpecialToken {
    Text(String),
    Token { content: String },
}

impl Tokenizer {
    /// What a word is: an ending, letters, a digit, or whatever else there is but space.
    const WORDS: &str = r"'s|'t|'re|'ve|'m|'ll|'d|[\p{L}]+|[\p{N}]|[^\s\p{L}\p{N}]+";
    const START: &str = "<|startoftext|>";
    const END: &str = "<|endoftext|>";
    /// Tokens of a text, where the files do not say.
    const LENGTH: usize = 77;
    const LONGEST: usize = 1 << 16;

    /// The tokenizer in `folder`: `vocab.json`, `merges.txt`, and, if they are there,
    /// `tokenizer_config.json` and `special_tokens_map.json`.
    ///
    /// Which token is the padding matters: Stable Diffusion 2.1's is not the end marker, as CLIP's is,
    /// but `!`. As in transformers, `special_tokens_map.json` decides, unless `tokenizer_config.json` lists
    /// all special tokens, as newer versions write it.
    ///
    /// # Errors
    ///
    /// If a file cannot be read or is not what it should be, or the vocabulary lacks a token.
    pub fn open(folder: &Path) -> Result<Self> {
        let vocabulary_path = folder.join("vocab.json");
        let vocabulary: BTreeMap<String, u32> = read(&vocabulary_path)?;
        let merges = merges(&folder.join("merges.txt"), &vocabulary)?;
        let config: Option<ConfigFile> = read_if_there(&folder.join("tokenizer_config.json"))?;
        let length = config.as_ref().and_then(|file| file.model_max_length);
        let listed = (config.as_ref()).is_some_and(|file| file.added_tokens_decoder.is_some());
        let in_config = config.map(|file| file.special).unwrap_or_default();
        let map: Option<SpecialTokens> = match listed {
            true => None,
            false => read_if_there(&folder.join("special_tokens_map.json"))?,
        };
        let map = map.unwrap_or_default();
        let id = |[first, second]: [Option<SpecialToken>; 2], default: &str| {
            let token = match first.or(second) {
                Some(SpecialToken::Text(content) | SpecialToken::Token { content }) => content,
                None => default.to_owned(),
            };
            match vocabulary.get(&token) {
                Some(&id) => Ok((token, id)),
                None => Err(problem(
                    &vocabulary_path,
                    &format!("the special token {token} is missing"),
                )),
            }
        };
        let start = id([map.bos_token, in_config.bos_token], Self::START)?;
        let end = id([map.eos_token, in_config.eos_token], Self::END)?;
        let padding = id([map.pad_token, in_config.pad_token], Self::END)?;
        let special = [&start, &end, &padding].map(|(token, _)| token.clone());
        let vocabulary = vocabulary.into_iter().collect();
        let inner = inner(vocabulary, merges, special)
            .map_err(|e| problem(folder, &format!("no tokenizer can be made of it ({e})")))?;
        Ok(Self {
            inner,
            start: start.1,
            end: end.1,
            padding: padding.1,
            length: match length {
                // Both markers and a token between.
                Some(length) if (3.0..=Self::LONGEST as f64).contains(&length) => length as usize,
                _ => Self::LENGTH,
            },
        })
    }

    /// The tokens of `text`: the start marker, as many of the text's tokens as there is room for, the end
    /// marker, and padding up to the length that all texts have (77).
    ///
    /// # Errors
    ///
    /// Should the text not be divisible into words, which does not happen.
    pub fn encode(&self, text: &str) -> Result<Vec<u32>> {
        // Before anything else: what a letter becomes can depend on its neighbours.
        let encoding = self.inner.encode_fast(text.to_lowercase(), false);
        let encoding = encoding.map_err(|e| Error::Msg(format!("the text {text:?}: {e}")))?;
        let tokens = encoding.get_ids().iter().copied().take(self.length - 2);
        let mut ids = Vec::with_capacity(self.length);
        ids.push(self.start);
        ids.extend(tokens);
        ids.push(self.end);
        ids.resize(self.length, self.padding);
        Ok(ids)
    }
}

/// The part without markers.
fn inner(
    vocabulary: Vocab,
    merges: Vec<(String, String)>,
    special: [String; 3],
) -> tokenizers::Result<tokenizers::Tokenizer> {
    let model = BPE::builder()
        .vocab_and_merges(vocabulary, merges)
        .unk_token(Tokenizer::END.to_owned())
        .end_of_word_suffix("</w>".to_owned())
        .build()?;
    let words = SplitPattern::Regex(Tokenizer::WORDS.to_owned());
    let words = Split::new(words, SplitDelimiterBehavior::Removed, true)?;
    let mut tokenizer = tokenizers::Tokenizer::new(model);
    tokenizer
        .with_normalizer(Some(Normalizers::new(vec![
            // No control characters, all space the same, ideographs apart.
            BertNormalizer::new(true, true, Some(false), false).into(),
            NFC.into(),
        ])))?
        .with_pre_tokenizer(Some(Splitters::new(vec![
            words.into(),
            // Bytes as letters.
            ByteLevel::new(false, false, false).into(),
        ])));
    // As in the original, a special token is one wherever it stands in a text: `!`, too.
    tokenizer.add_special_tokens(special.map(|token| AddedToken::from(token, true)))?;
    Ok(tokenizer)
}

/// Pairs of tokens that become one, the first ones first.
fn merges(path: &Path, vocabulary: &BTreeMap<String, u32>) -> Result<Vec<(String, String)>> {
    let text = fs::read_to_string(path).map_err(|e| problem(path, &e))?;
    let lines = text.lines().enumerate();
    lines
        .filter(|(_, line)| !line.starts_with("#version") && !line.trim().is_empty())
        .map(|(i, line)| {
            let number = i + 1;
            let Some((first, second)) = line.trim().split_once(' ') else {
                return Err(problem(
                    path,
                    &format!("line {number} is no pair of tokens"),
                ));
            };
            for token in [first, second, &format!("{first}{second}")] {
                if !vocabulary.contains_key(token) {
                    let text = format!("line {number}: `{token}` is not in the vocabulary");
                    return Err(problem(path, &text));
                }
            }
            Ok((first.to_owned(), second.to_owned()))
        })
        .collect()
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = fs::read_to_string(path).map_err(|e| problem(path, &e))?;
    serde_json::from_str(&text).map_err(|e| problem(path, &e))
}

fn read_if_there<T: DeserializeOwned>(path: &Path) -> Result<Option<T>> {
    match path.exists() {
        true => read(path).map(Some),
        false => Ok(None),
    }
}

fn problem(path: &Path, text: &dyn Display) -> Error {
    Error::Msg(format!("{}: {text}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const VOCABULARY: &str = r#"{"!": 0, "a": 1, "b": 2, "ab": 3, "b</w>": 4, "ab</w>": 5, "1</w>": 6,
        "c</w>": 7, "Ã": 8, "¤</w>": 9, "Ã¤</w>": 10, "<|startoftext|>": 11, "<|endoftext|>": 12,
        "a</w>": 13, "'s</w>": 14, "s</w>": 15, "'": 16}"#;
    const MERGES: &str = "#version: 0.2\na b\na b</w>\nÃ ¤</w>\n' s</w>\n";

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in [("vocab.json", VOCABULARY), ("merges.txt", MERGES)] {
            fs::write(folder.path().join(name), text).unwrap();
        }
        for (name, text) in files {
            fs::write(folder.path().join(name), text).unwrap();
        }
        folder
    }

    fn encode(files: &[(&str, &str)], text: &str) -> Vec<u32> {
        let folder = folder(files);
        Tokenizer::open(folder.path())
            .unwrap()
            .encode(text)
            .unwrap()
    }

    #[test]
    fn words_by_hand() {
        let files = [("special_tokens_map.json", r#"{"pad_token": "!"}"#)];
        // The merge of `a b` comes before that of `a b</w>`, but there is no `ab b</w>`.
        for (text, want) in [
            ("", &[][..]),
            ("ab", &[5]),
            ("  AB\n\tab ", &[5, 5]),
            ("abb", &[3, 4]),
            ("11", &[6, 6]),
            // A letter of two bytes, also as a letter and an accent.
            ("ä", &[10]),
            ("A\u{308}", &[10]),
            ("b's", &[4, 14]),
            // The padding is a special token wherever it stands.
            ("a!b", &[13, 0, 4]),
            ("a<|endoftext|>", &[13, 12]),
        ] {
            let ids = encode(&files, text);
            assert_eq!(ids.len(), 77);
            let after = want.len() + 1;
            assert_eq!(
                (ids[0], &ids[1..after], ids[after]),
                (11, want, 12),
                "{text}"
            );
            assert!(ids[after + 1..].iter().all(|&id| id == 0), "{text}");
        }
    }

    #[test]
    fn long_texts_keep_the_end_marker() {
        let config = r#"{"model_max_length": 5, "pad_token": {"content": "a", "lstrip": false}}"#;
        let files = [("tokenizer_config.json", config)];
        assert_eq!(encode(&files, "c c c c c c"), [11, 7, 7, 7, 12]);
        assert_eq!(encode(&files, "c c c"), [11, 7, 7, 7, 12]);
        assert_eq!(encode(&files, "c"), [11, 7, 12, 1, 1]);
    }

    #[test]
    fn which_file_decides() {
        let padding = |files: &[(&str, &str)]| encode(files, "")[76];
        assert_eq!(padding(&[]), 12);
        let config = ("tokenizer_config.json", r#"{"pad_token": "a"}"#);
        let map = (
            "special_tokens_map.json",
            r#"{"pad_token": {"content": "b"}}"#,
        );
        assert_eq!(padding(&[config]), 1);
        assert_eq!(padding(&[config, map]), 2);
        let listing = r#"{"pad_token": "a", "added_tokens_decoder": {"1": {"content": "a"}},
            "model_max_length": 1e30}"#;
        assert_eq!(padding(&[("tokenizer_config.json", listing), map]), 1);
    }

    #[test]
    fn what_is_wrong_is_said_with_the_file() {
        for (name, text, wanted) in [
            ("vocab.json", "[]", "vocab.json"),
            ("vocab.json", r#"{"a": 0}"#, "not in the vocabulary"),
            ("merges.txt", "a\n", "line 1 is no pair"),
            ("merges.txt", "#version: 1\na a\n", "line 2: `aa`"),
            (
                "special_tokens_map.json",
                r#"{"pad_token": "?"}"#,
                "token ? is missing",
            ),
            (
                "tokenizer_config.json",
                r#"{"pad_token": 3}"#,
                "tokenizer_config.json",
            ),
        ] {
            let folder = folder(&[(name, text)]);
            let message = Tokenizer::open(folder.path()).unwrap_err().to_string();
            assert!(message.contains(wanted), "{message}");
        }
        let empty = tempfile::tempdir().unwrap();
        let message = Tokenizer::open(empty.path()).unwrap_err().to_string();
        assert!(message.contains("vocab.json"), "{message}");
    }
}
