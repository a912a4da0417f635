//! As much of Protocol Buffers as messages of a recording need: fields of four kinds, written one after the
//! other. <https://protobuf.dev/programming-guides/encoding>

/// A message, field by field.
#[derive(Default)]
pub(super) struct Message(Vec<u8>);

const VARINT: u32 = 0;
const FIXED_64: u32 = 1;
const LENGTH_FIRST: u32 = 2;

impl Message {
    /// A field that is a number.
    pub(super) fn number(mut self, field: u32, value: u64) -> Self {
        self.key(field, VARINT);
        self.varint(value);
        self
    }

    /// A field that is a number of fixed length.
    pub(super) fn fixed64(mut self, field: u32, value: u64) -> Self {
        self.key(field, FIXED_64);
        self.0.extend(value.to_le_bytes());
        self
    }

    /// A field that is text or bytes.
    pub(super) fn bytes(mut self, field: u32, value: &[u8]) -> Self {
        self.key(field, LENGTH_FIRST);
        self.varint(value.len() as u64);
        self.0.extend(value);
        self
    }

    /// A field that is a message.
    pub(super) fn message(self, field: u32, value: &Self) -> Self {
        self.bytes(field, &value.0)
    }

    /// The message as it is written.
    pub(super) fn finish(self) -> Vec<u8> {
        self.0
    }

    fn key(&mut self, field: u32, kind: u32) {
        self.varint(u64::from(field << 3 | kind));
    }

    /// Seven bits to a byte, the lowest first; the eighth says that more follow.
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_written_as_the_documentation_has_them() {
        // Examples of the encoding guide.
        let message = Message::default().number(1, 150);
        let outer = Message::default().message(3, &message);
        assert_eq!(outer.finish(), [0x1a, 0x03, 0x08, 0x96, 0x01]);
        assert_eq!(message_of("testing"), b"\x12\x07testing");
        let fixed = Message::default().fixed64(16, 258).finish();
        assert_eq!(fixed, [0x81, 0x01, 2, 1, 0, 0, 0, 0, 0, 0]);
    }

    fn message_of(text: &str) -> Vec<u8> {
        Message::default().bytes(2, text.as_bytes()).finish()
    }
}
