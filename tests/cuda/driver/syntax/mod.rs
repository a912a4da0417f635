//! PTX as text, taken apart: variables and functions, whose bodies are statements.

mod parser;
mod tokens;

pub(crate) use parser::parse;
use std::collections::HashMap;

/// A file of PTX. Its text is kept for as long as the program runs.
#[derive(Default)]
pub(crate) struct Module {
    pub(crate) variables: HashMap<&'static str, Variable>,
    pub(crate) functions: HashMap<&'static str, Function>,
    pub(crate) lines: Vec<&'static str>,
    /// Where variables in global memory were put.
    pub(crate) places: HashMap<&'static str, u64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Space {
    Generic,
    Global,
    Shared,
    Local,
    Param,
}

/// What has a name and memory.
#[derive(Clone, Default)]
pub(crate) struct Variable {
    pub(crate) name: &'static str,
    /// As in `.shared`.
    pub(crate) space: &'static str,
    pub(crate) align: usize,
    /// 0 where the launch decides.
    pub(crate) bytes: usize,
    pub(crate) start: Vec<u8>,
}

#[derive(Default)]
pub(crate) struct Function {
    pub(crate) is_entry: bool,
    pub(crate) results: Vec<Variable>,
    pub(crate) parameters: Vec<Variable>,
    /// None where the function is only declared.
    pub(crate) body: Option<Vec<Statement>>,
    /// The most threads in a block.
    pub(crate) threads: Option<u32>,
}

pub(crate) enum Statement {
    Open,
    Close,
    Label(&'static str),
    Registers {
        kind: &'static str,
        names: Vec<(&'static str, Option<u32>)>,
    },
    Variable(Variable),
    Targets {
        name: &'static str,
        labels: Vec<&'static str>,
    },
    Instruction(Instruction),
}

pub(crate) struct Instruction {
    /// From 1.
    pub(crate) line: u32,
    /// A predicate, and whether it has to be false.
    pub(crate) guard: Option<(&'static str, bool)>,
    pub(crate) opcode: &'static str,
    pub(crate) operands: Vec<Operand>,
}

#[derive(Clone, Debug)]
pub(crate) enum Operand {
    Name(&'static str),
    /// `!p`
    Not(&'static str),
    /// `p|q`
    Pair(&'static str, &'static str),
    Number(Number),
    /// `{a, b}`
    Vector(Vec<Operand>),
    /// `(a, b)`
    Group(Vec<Operand>),
    /// `[a + 4]`
    Address(Box<Operand>, i64),
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum Number {
    Whole(i128),
    F32(u32),
    F64(u64),
}

/// Bytes of a type, as in `.f32`.
pub(crate) fn bytes_of(kind: &str) -> Option<usize> {
    Some(match kind {
        ".pred" | ".b8" | ".u8" | ".s8" => 1,
        ".b16" | ".u16" | ".s16" | ".f16" | ".bf16" => 2,
        ".b32" | ".u32" | ".s32" | ".f32" | ".f16x2" | ".bf16x2" => 4,
        ".b64" | ".u64" | ".s64" | ".f64" => 8,
        _ => return None,
    })
}
