//! The Python expression with which a training script made its network.
//!
//! It is a call with keyword arguments, `Class(a=1, b=('exp', -inf, inf), c={'skip': True})`, and is
//! parsed as that. Anything else, names and calls within the arguments included, is an error:
//! nothing is looked up or evaluated.

use serde_json::{Map, Number, Value};

/// The longest expression that is parsed, in bytes.
const LONGEST: usize = 1 << 16;
/// How deep arguments may be nested.
const DEEPEST: usize = 8;

/// The keyword arguments of the call in `text`. Tuples are arrays; infinities, which JSON lacks,
/// the texts `inf` and `-inf`; whole numbers are integers however they are written.
///
/// # Errors
///
/// What is wrong with the expression, as part of a message.
pub(super) fn arguments(text: &str) -> Result<Map<String, Value>, String> {
    if text.len() > LONGEST {
        return Err(format!("it has {} characters", text.len()));
    }
    let mut parser = Parser { rest: text };
    parser.name()?;
    parser.expect('(')?;
    let mut arguments = Map::new();
    while !parser.accept(')') {
        let name = parser.name()?;
        parser.expect('=')?;
        let value = parser.value(0)?;
        arguments.insert(name.to_owned(), value);
        if !parser.accept(',') {
            parser.expect(')')?;
            break;
        }
    }
    match parser.peek() {
        None => Ok(arguments),
        Some(_) => Err(parser.unexpected("the end")),
    }
}

struct Parser<'a> {
    rest: &'a str,
}

impl<'a> Parser<'a> {
    fn peek(&mut self) -> Option<char> {
        self.rest = self.rest.trim_start();
        self.rest.chars().next()
    }

    fn accept(&mut self, wanted: char) -> bool {
        let found = self.peek() == Some(wanted);
        if found {
            self.rest = &self.rest[wanted.len_utf8()..];
        }
        found
    }

    fn expect(&mut self, wanted: char) -> Result<(), String> {
        if self.accept(wanted) {
            Ok(())
        } else {
            Err(self.unexpected(&format!("`{wanted}`")))
        }
    }

    fn unexpected(&self, wanted: &str) -> String {
        let found: String = self
            .rest
            .chars()
            .take(20)
            .flat_map(char::escape_debug)
            .collect();
        format!("{wanted} is expected before `{found}`")
    }

    /// Splits off what consists of characters that `belong`.
    fn word(&mut self, belong: impl Fn(char) -> bool) -> &'a str {
        self.peek();
        let end = self.rest.find(|c| !belong(c)).unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(end);
        self.rest = rest;
        word
    }

    fn name(&mut self) -> Result<&'a str, String> {
        match self.word(|c| c.is_ascii_alphanumeric() || c == '_' || c == '.') {
            "" => Err(self.unexpected("a name")),
            name => Ok(name),
        }
    }

    fn value(&mut self, depth: usize) -> Result<Value, String> {
        if depth > DEEPEST {
            return Err("its arguments are nested too deep".to_owned());
        }
        match self.peek() {
            Some(quote @ ('\'' | '"')) => self.text(quote).map(Value::String),
            Some('(') => self.sequence(')', depth),
            Some('[') => self.sequence(']', depth),
            Some('{') => self.dictionary(depth),
            _ => self.scalar(),
        }
    }

    fn text(&mut self, quote: char) -> Result<String, String> {
        self.expect(quote)?;
        let Some(end) = self.rest.find(quote) else {
            return Err(self.unexpected("a closing quotation mark"));
        };
        let (text, rest) = self.rest.split_at(end);
        if text.contains('\\') {
            return Err(self.unexpected("a text without escapes"));
        }
        self.rest = &rest[quote.len_utf8()..];
        Ok(text.to_owned())
    }

    fn sequence(&mut self, close: char, depth: usize) -> Result<Value, String> {
        self.rest = &self.rest[1..];
        let mut values = Vec::new();
        while !self.accept(close) {
            values.push(self.value(depth + 1)?);
            if !self.accept(',') {
                self.expect(close)?;
                break;
            }
        }
        Ok(Value::Array(values))
    }

    fn dictionary(&mut self, depth: usize) -> Result<Value, String> {
        self.expect('{')?;
        let mut entries = Map::new();
        while !self.accept('}') {
            let key = match self.value(depth + 1)? {
                Value::String(key) => key,
                other => return Err(format!("{other} is no key of an argument")),
            };
            self.expect(':')?;
            let value = self.value(depth + 1)?;
            entries.insert(key, value);
            if !self.accept(',') {
                self.expect('}')?;
                break;
            }
        }
        Ok(Value::Object(entries))
    }

    fn scalar(&mut self) -> Result<Value, String> {
        let before = self.rest;
        let word = self.word(|c| c.is_ascii_alphanumeric() || "._+-".contains(c));
        let number = |value: f64| {
            const WHOLE: f64 = 9_007_199_254_740_992.0; // 2^53: f64 is exact below
            if value.fract() == 0.0 && value.abs() < WHOLE {
                Some(Number::from(value as i64))
            } else {
                Number::from_f64(value)
            }
        };
        let value = match word {
            "True" => Some(Value::Bool(true)),
            "False" => Some(Value::Bool(false)),
            "None" => Some(Value::Null),
            "inf" | "+inf" => Some(Value::from("inf")),
            "-inf" => Some(Value::from("-inf")),
            // Only digits: Rust would take `nan` and `infinity` for numbers.
            _ if word.contains(|c: char| c.is_ascii_digit()) => {
                word.parse().ok().and_then(number).map(Value::Number)
            }
            _ => None,
        };
        value.ok_or_else(|| {
            self.rest = before;
            self.unexpected("a number, text, tuple or dictionary")
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    #[test]
    fn arguments_of_every_kind() {
        let text = "Net.Sub(pos_embed='RoPE100', img_size=(224, 224), depth_mode=('exp', -inf, inf), \
                    conf_mode = (\"exp\", 1, 1e9), a=[], b=(3,), c={'skip':True, 'n': None}, d=-2.5, )";
        let found = Value::Object(arguments(text).unwrap());
        assert_eq!(
            found,
            json!({
                "pos_embed": "RoPE100", "img_size": [224, 224], "depth_mode": ["exp", "-inf", "inf"],
                "conf_mode": ["exp", 1, 1_000_000_000], "a": [], "b": [3],
                "c": {"skip": true, "n": null}, "d": -2.5,
            })
        );
        assert!(arguments("Net()").unwrap().is_empty());
    }

    #[test]
    fn nothing_but_arguments_is_understood() {
        for text in [
            "",
            "Net",
            "Net(",
            "Net(1)",
            "Net(a)",
            "Net(a=)",
            "Net(a=b)",
            "Net(a=__import__('os').system('x'))",
            "Net(a=1+1)",
            "Net(a=nan)",
            "Net(a='x)",
            "Net(a='\\x41')",
            "Net(a={1: 2})",
            "Net(a=1) or x",
            "Net(a=1, b=2",
            "Net(a=1e999)",
            "Net(a=é)",
        ] {
            assert!(arguments(text).is_err(), "{text}");
        }
        assert!(arguments(&format!("Net(a={})", "(".repeat(60_000))).is_err());
        assert!(arguments(&" ".repeat(LONGEST + 1)).is_err());
    }

    proptest! {
        #[test]
        fn no_text_brings_it_down(text in ".{0,40}", inner in "[-a-z0-9'(){}\\[\\],:=. éü]{0,40}") {
            let _ = arguments(&text);
            let _ = arguments(&format!("N(a={inner})"));
        }
    }
}
