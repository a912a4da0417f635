//! The stack machine.

use std::collections::HashMap;

use super::{Id, MOST_BYTES, Node, Object, Pickle, PickleError};

/// The most instructions that are followed: ten times as many as the largest known checkpoint has.
/// Each makes at most one node, one entry of the stack and one of the memo.
const MOST_STEPS: usize = 1 << 20;

/// Instructions, under their names in Python's `pickletools`.
mod op {
    pub(super) const MARK: u8 = b'(';
    pub(super) const STOP: u8 = b'.';
    pub(super) const POP: u8 = b'0';
    pub(super) const POP_MARK: u8 = b'1';
    pub(super) const DUP: u8 = b'2';
    pub(super) const BINBYTES: u8 = b'B';
    pub(super) const SHORT_BINBYTES: u8 = b'C';
    pub(super) const BINFLOAT: u8 = b'G';
    pub(super) const BININT: u8 = b'J';
    pub(super) const BININT1: u8 = b'K';
    pub(super) const BININT2: u8 = b'M';
    pub(super) const NONE: u8 = b'N';
    pub(super) const BINPERSID: u8 = b'Q';
    pub(super) const REDUCE: u8 = b'R';
    pub(super) const BINSTRING: u8 = b'T';
    pub(super) const SHORT_BINSTRING: u8 = b'U';
    pub(super) const BINUNICODE: u8 = b'X';
    pub(super) const EMPTY_LIST: u8 = b']';
    pub(super) const APPEND: u8 = b'a';
    pub(super) const BUILD: u8 = b'b';
    pub(super) const GLOBAL: u8 = b'c';
    pub(super) const DICT: u8 = b'd';
    pub(super) const APPENDS: u8 = b'e';
    pub(super) const BINGET: u8 = b'h';
    pub(super) const LONG_BINGET: u8 = b'j';
    pub(super) const LIST: u8 = b'l';
    pub(super) const OBJ: u8 = b'o';
    pub(super) const BINPUT: u8 = b'q';
    pub(super) const LONG_BINPUT: u8 = b'r';
    pub(super) const SETITEM: u8 = b's';
    pub(super) const TUPLE: u8 = b't';
    pub(super) const SETITEMS: u8 = b'u';
    pub(super) const EMPTY_DICT: u8 = b'}';
    pub(super) const EMPTY_TUPLE: u8 = b')';
    pub(super) const PROTO: u8 = 0x80;
    pub(super) const NEWOBJ: u8 = 0x81;
    pub(super) const TUPLE1: u8 = 0x85;
    pub(super) const TUPLE2: u8 = 0x86;
    pub(super) const TUPLE3: u8 = 0x87;
    pub(super) const NEWTRUE: u8 = 0x88;
    pub(super) const NEWFALSE: u8 = 0x89;
    pub(super) const LONG1: u8 = 0x8a;
    pub(super) const LONG4: u8 = 0x8b;
    pub(super) const SHORT_BINUNICODE: u8 = 0x8c;
    pub(super) const BINUNICODE8: u8 = 0x8d;
    pub(super) const BINBYTES8: u8 = 0x8e;
    pub(super) const EMPTY_SET: u8 = 0x8f;
    pub(super) const ADDITEMS: u8 = 0x90;
    pub(super) const FROZENSET: u8 = 0x91;
    pub(super) const NEWOBJ_EX: u8 = 0x92;
    pub(super) const STACK_GLOBAL: u8 = 0x93;
    pub(super) const MEMOIZE: u8 = 0x94;
    pub(super) const FRAME: u8 = 0x95;
    pub(super) const BYTEARRAY8: u8 = 0x96;
}

/// Follows the pickle that `bytes` begin with to its end, and says where that is.
pub(super) fn run(bytes: &[u8]) -> Result<(Pickle<'_>, usize), PickleError> {
    let mut machine = Machine {
        bytes,
        at: 0,
        nodes: Vec::new(),
        stack: Vec::new(),
        marks: Vec::new(),
        memo: HashMap::new(),
    };
    let mut position = 0;
    let root = if bytes.len() as u64 > MOST_BYTES {
        Err(format!("it has more than {MOST_BYTES} bytes"))
    } else {
        machine.run(&mut position)
    };
    match root {
        Ok(root) => {
            let nodes = machine.nodes;
            Ok((Pickle { nodes, root }, machine.at))
        }
        Err(problem) => Err(PickleError { position, problem }),
    }
}

type Step<T = ()> = Result<T, String>;

struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    nodes: Vec<Node<'a>>,
    stack: Vec<Id>,
    /// Heights of the stack at which marks were set.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
}

impl<'a> Machine<'a> {
    /// Runs to the end; `position` is that of the instruction last begun.
    fn run(&mut self, position: &mut usize) -> Step<Id> {
        for _ in 0..MOST_STEPS {
            *position = self.at;
            let [code] = self.take()?;
            if code == op::STOP {
                return self.pop();
            }
            self.step(code)?;
        }
        Err(format!("it has more than {MOST_STEPS} instructions"))
    }

    fn step(&mut self, code: u8) -> Step {
        match code {
            op::PROTO => match self.take()? {
                [2..=5] => Ok(()),
                [other] => Err(format!("protocol {other} is none of 2 to 5")),
            },
            op::FRAME => self.take::<8>().map(drop),

            op::NONE => self.push(Node::None),
            op::NEWTRUE => self.push(Node::Bool(true)),
            op::NEWFALSE => self.push(Node::Bool(false)),
            op::BININT => self
                .take()
                .map(i32::from_le_bytes)
                .and_then(|n| self.int(n)),
            op::BININT1 => self.take().map(u8::from_le_bytes).and_then(|n| self.int(n)),
            op::BININT2 => self
                .take()
                .map(u16::from_le_bytes)
                .and_then(|n| self.int(n)),
            op::LONG1 => self.counted::<1>().and_then(|bytes| self.long(bytes)),
            op::LONG4 => self.counted::<4>().and_then(|bytes| self.long(bytes)),
            op::BINFLOAT => {
                let value = f64::from_be_bytes(self.take()?);
                self.push(Node::Float(value))
            }
            op::SHORT_BINSTRING | op::SHORT_BINUNICODE => self.text::<1>(),
            op::BINSTRING | op::BINUNICODE => self.text::<4>(),
            op::BINUNICODE8 => self.text::<8>(),
            op::SHORT_BINBYTES => self.counted::<1>().and_then(|b| self.push(Node::Bytes(b))),
            op::BINBYTES => self.counted::<4>().and_then(|b| self.push(Node::Bytes(b))),
            op::BINBYTES8 | op::BYTEARRAY8 => {
                self.counted::<8>().and_then(|b| self.push(Node::Bytes(b)))
            }

            op::EMPTY_TUPLE => self.push(Node::Tuple(Vec::new())),
            op::TUPLE1 => self.tuple(1),
            op::TUPLE2 => self.tuple(2),
            op::TUPLE3 => self.tuple(3),
            op::TUPLE => self
                .marked()
                .and_then(|parts| self.push(Node::Tuple(parts))),
            op::EMPTY_LIST => self.push(Node::List(Vec::new())),
            op::LIST => self.marked().and_then(|parts| self.push(Node::List(parts))),
            op::EMPTY_SET => self.push(Node::Set(Vec::new())),
            op::FROZENSET => self.marked().and_then(|parts| self.push(Node::Set(parts))),
            op::EMPTY_DICT => self.push(Node::Dict(Vec::new())),
            op::DICT => {
                let items = self.marked_pairs()?;
                self.push(Node::Dict(items))
            }
            op::APPEND => {
                let value = self.pop()?;
                self.append(&[value])
            }
            op::APPENDS | op::ADDITEMS => {
                let values = self.marked()?;
                self.append(&values)
            }
            op::SETITEM => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.set(&[(key, value)])
            }
            op::SETITEMS => {
                let items = self.marked_pairs()?;
                self.set(&items)
            }

            op::GLOBAL => {
                let (module, name) = (self.line()?, self.line()?);
                self.push(Node::Global { module, name })
            }
            op::STACK_GLOBAL => {
                let (name, module) = (self.pop()?, self.pop()?);
                match (self.node(module), self.node(name)) {
                    (&Node::Text(module), &Node::Text(name)) => {
                        self.push(Node::Global { module, name })
                    }
                    _ => Err("a global has no text for a name".to_owned()),
                }
            }
            op::REDUCE | op::NEWOBJ => {
                let (arguments, callable) = (self.pop()?, self.pop()?);
                self.object(callable, arguments)
            }
            op::NEWOBJ_EX => {
                // Arguments by name are no concern of anything that is read.
                let (_named, arguments, callable) = (self.pop()?, self.pop()?, self.pop()?);
                self.object(callable, arguments)
            }
            op::OBJ => {
                let mut parts = self.marked()?;
                if parts.is_empty() {
                    return Err("an object has no class".to_owned());
                }
                let callable = parts.remove(0);
                self.push(Node::Tuple(parts))?;
                let arguments = self.pop()?;
                self.object(callable, arguments)
            }
            op::BUILD => {
                let state = self.pop()?;
                match self.top()? {
                    Node::Object(object) => object.state = Some(state),
                    _ => return Err("what is no object is given a state".to_owned()),
                }
                Ok(())
            }
            op::BINPERSID => self.pop().and_then(|id| self.push(Node::Persistent(id))),

            op::BINPUT => self.take::<1>().and_then(|[n]| self.remember(n.into())),
            op::LONG_BINPUT => {
                let index = self.take().map(u32::from_le_bytes)?;
                self.remember(index)
            }
            op::MEMOIZE => self.remember(self.memo.len() as u32),
            op::BINGET => self.take::<1>().and_then(|[n]| self.recall(n.into())),
            op::LONG_BINGET => {
                let index = self.take().map(u32::from_le_bytes)?;
                self.recall(index)
            }

            op::MARK => {
                self.marks.push(self.stack.len());
                Ok(())
            }
            op::POP => self.pop().map(drop),
            op::POP_MARK => self.marked().map(drop),
            op::DUP => {
                let id = self.peek()?;
                self.stack.push(id);
                Ok(())
            }
            other => Err(format!("{other:#04x} is no instruction that is known")),
        }
    }

    /// The next `N` bytes.
    fn take<const N: usize>(&mut self) -> Step<[u8; N]> {
        let (head, _) = (self.bytes.get(self.at..))
            .and_then(|rest| rest.split_first_chunk())
            .ok_or_else(|| "it is cut short".to_owned())?;
        self.at += N;
        Ok(*head)
    }

    /// As many bytes as the next `N` bytes say; they are looked at only if they are there.
    fn counted<const N: usize>(&mut self) -> Step<&'a [u8]> {
        let mut wide = [0; 8];
        wide[..N].copy_from_slice(&self.take::<N>()?);
        let count = u64::from_le_bytes(wide);
        let rest = &self.bytes[self.at..];
        match usize::try_from(count).ok().and_then(|n| rest.get(..n)) {
            Some(bytes) => {
                self.at += bytes.len();
                Ok(bytes)
            }
            None => Err(format!(
                "{count} bytes are announced and {} are left",
                rest.len()
            )),
        }
    }

    fn utf8(bytes: &'a [u8]) -> Step<&'a str> {
        std::str::from_utf8(bytes).map_err(|_| "a text is not UTF-8".to_owned())
    }

    fn line(&mut self) -> Step<&'a str> {
        let rest = &self.bytes[self.at..];
        let end = (rest.iter().position(|&byte| byte == b'\n'))
            .ok_or_else(|| "it is cut short".to_owned())?;
        self.at += end + 1;
        Self::utf8(&rest[..end])
    }

    fn text<const N: usize>(&mut self) -> Step {
        let text = Self::utf8(self.counted::<N>()?)?;
        self.push(Node::Text(text))
    }

    fn int(&mut self, value: impl Into<i64>) -> Step {
        self.push(Node::Int(value.into()))
    }

    /// Little-endian, two's complement, no bytes for zero.
    fn long(&mut self, bytes: &'a [u8]) -> Step {
        let negative = bytes.last().is_some_and(|&byte| byte >= 0x80);
        let mut wide = [if negative { 0xff } else { 0 }; 8];
        match wide.get_mut(..bytes.len()) {
            Some(low) => {
                low.copy_from_slice(bytes);
                self.int(i64::from_le_bytes(wide))
            }
            None => self.push(Node::LargeInt(bytes)),
        }
    }

    fn push(&mut self, node: Node<'a>) -> Step {
        let id = u32::try_from(self.nodes.len()).map_err(|_| "it has too many values")?;
        self.nodes.push(node);
        self.stack.push(Id(id));
        Ok(())
    }

    fn node(&self, id: Id) -> &Node<'a> {
        &self.nodes[id.0 as usize]
    }

    /// The uppermost value, if it is above the last mark.
    fn peek(&self) -> Step<Id> {
        let floor = self.marks.last().copied().unwrap_or(0);
        match self.stack.last() {
            Some(&id) if self.stack.len() > floor => Ok(id),
            _ => Err("it takes more values than it has made".to_owned()),
        }
    }

    fn pop(&mut self) -> Step<Id> {
        let id = self.peek()?;
        self.stack.pop();
        Ok(id)
    }

    fn top(&mut self) -> Step<&mut Node<'a>> {
        let id = self.peek()?;
        Ok(&mut self.nodes[id.0 as usize])
    }

    /// The values above the last mark, which goes.
    fn marked(&mut self) -> Step<Vec<Id>> {
        let mark = self
            .marks
            .pop()
            .ok_or("it goes back to a mark that it has not set")?;
        Ok(self.stack.split_off(mark))
    }

    fn marked_pairs(&mut self) -> Step<Vec<(Id, Id)>> {
        let values = self.marked()?;
        match values.as_chunks() {
            (pairs, []) => Ok(pairs.iter().map(|&[key, value]| (key, value)).collect()),
            _ => Err("a key has no value".to_owned()),
        }
    }

    fn tuple(&mut self, count: usize) -> Step {
        let mut parts = (0..count).map(|_| self.pop()).collect::<Step<Vec<_>>>()?;
        parts.reverse();
        self.push(Node::Tuple(parts))
    }

    fn object(&mut self, callable: Id, arguments: Id) -> Step {
        self.push(Node::Object(Box::new(Object {
            callable,
            arguments,
            items: Vec::new(),
            elements: Vec::new(),
            state: None,
        })))
    }

    fn append(&mut self, values: &[Id]) -> Step {
        match self.top()? {
            Node::List(list) | Node::Set(list) => list.extend(values),
            Node::Object(object) => object.elements.extend(values),
            _ => return Err("what is no list is appended to".to_owned()),
        }
        Ok(())
    }

    fn set(&mut self, items: &[(Id, Id)]) -> Step {
        match self.top()? {
            Node::Dict(entries) => entries.extend(items),
            Node::Object(object) => object.items.extend(items),
            _ => return Err("what is no dictionary is given entries".to_owned()),
        }
        Ok(())
    }

    fn remember(&mut self, index: u32) -> Step {
        let id = self.peek()?;
        self.memo.insert(index, id);
        Ok(())
    }

    fn recall(&mut self, index: u32) -> Step {
        let id = self.memo.get(&index);
        let id = id.ok_or_else(|| format!("it recalls value {index}, which it never kept"))?;
        self.stack.push(*id);
        Ok(())
    }
}
