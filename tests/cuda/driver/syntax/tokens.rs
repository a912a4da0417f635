//! The words and signs of PTX.

pub(super) struct Token {
    pub(super) text: &'static str,
    pub(super) line: u32,
}

pub(super) fn tokens(text: &'static str) -> Result<Vec<Token>, String> {
    let bytes = text.as_bytes();
    let in_word =
        |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'$' | b'%' | b'.');
    let (mut at, mut line, mut found) = (0, 1, Vec::new());
    while at < bytes.len() {
        let from = at;
        at += 1;
        match bytes[from] {
            b'\n' => line += 1,
            byte if byte.is_ascii_whitespace() => {}
            b'/' if bytes.get(at) == Some(&b'/') => {
                at += text[at..].find('\n').unwrap_or(text.len() - at)
            }
            b'/' if bytes.get(at) == Some(&b'*') => {
                let end = at + text[at..].find("*/").ok_or("a comment has no end")? + 2;
                line += text[at..end].matches('\n').count() as u32;
                at = end;
            }
            b'"' => {
                at += text[at..].find('"').ok_or("a text has no end")? + 1;
                found.push(Token {
                    text: &text[from..at],
                    line,
                });
            }
            byte => {
                while in_word(byte)
                    && at < bytes.len()
                    && (in_word(bytes[at]) || text[at..].starts_with("::"))
                {
                    at += if bytes[at] == b':' { 2 } else { 1 };
                }
                found.push(Token {
                    text: &text[from..at],
                    line,
                });
            }
        }
    }
    Ok(found)
}
