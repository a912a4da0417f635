//! From statements to steps: names become places, calls become the function's own steps.

mod access;
mod convert;
mod float;
mod integer;
mod line;
mod moves;
mod predicate;
mod together;

use self::line::Line;
use crate::program::{CARRY, Constant, Op, Parameter, Place, Program, SPECIAL, Step};
use crate::registers::LANES;
use crate::syntax::{Function, Instruction, Module, Operand, Statement, Variable, bytes_of};
use std::collections::HashMap;

/// Functions that call each other this often are not known.
const DEPTH: usize = 16;

pub(crate) fn compile(module: &Module, name: &str) -> Result<Program, String> {
    let function = module
        .functions
        .get(name)
        .filter(|function| function.is_entry);
    let function = function.ok_or_else(|| format!("there is no kernel `{name}`"))?;
    let mut compiler = Compiler {
        module,
        scopes: Vec::new(),
        steps: Vec::new(),
        registers: CARRY + 1,
        constants: HashMap::new(),
        labels: Vec::new(),
        ends: Vec::new(),
        shared: 0,
        shared_variables: HashMap::new(),
        dynamic_align: 1,
        local: 0,
        line: 0,
    };
    let (mut parameters, mut bytes, mut names) = (Vec::new(), 0_usize, HashMap::new());
    for variable in &function.parameters {
        let offset = bytes.next_multiple_of(variable.align);
        bytes = offset + variable.bytes;
        parameters.push(Parameter {
            offset,
            bytes: variable.bytes,
        });
        names.insert(variable.name, Name::Parameter(offset));
    }
    compiler.function(function, names)?;
    let dynamic = compiler.shared.next_multiple_of(compiler.dynamic_align);
    let constant = |((value, _), register)| match value {
        Value::Number(value) => Constant { register, value },
        Value::DynamicShared => Constant {
            register,
            value: dynamic as u64,
        },
    };
    let (labels, mut steps) = (compiler.labels, compiler.steps);
    for step in &mut steps {
        match &mut step.op {
            Op::Jump(label) => *label = labels[*label as usize],
            Op::JumpTo { places, .. } => places
                .iter_mut()
                .for_each(|label| *label = labels[*label as usize]),
            _ => {}
        }
    }
    Ok(Program {
        name: name.to_string(),
        has_barriers: steps
            .iter()
            .any(|step| matches!(step.op, Op::Barrier { .. })),
        steps,
        registers: compiler.registers,
        constants: compiler.constants.into_iter().map(constant).collect(),
        parameters,
        shared: dynamic,
        local: compiler.local,
        threads: function.threads,
        lines: module.lines.clone(),
    })
}

struct Compiler<'a> {
    module: &'a Module,
    scopes: Vec<Scope>,
    steps: Vec<Step>,
    registers: u32,
    constants: HashMap<(Value, bool), Place>,
    /// The step that each label is at.
    labels: Vec<u32>,
    /// Where called functions end: labels.
    ends: Vec<u32>,
    shared: usize,
    /// Where variables of a module lie that the kernel uses.
    shared_variables: HashMap<&'static str, usize>,
    dynamic_align: usize,
    local: usize,
    line: u32,
}

#[derive(Default)]
struct Scope {
    names: HashMap<&'static str, Name>,
    labels: HashMap<&'static str, u32>,
    targets: HashMap<&'static str, Vec<&'static str>>,
    /// Names of scopes before this one are not seen.
    is_function: bool,
}

#[derive(Clone, Copy)]
enum Name {
    Register(Place),
    Predicate(u32),
    Parameter(usize),
    Local(usize),
    Shared(usize),
    /// Shared memory whose size the launch says: after the rest.
    DynamicShared,
    Global(u64),
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Value {
    Number(u64),
    DynamicShared,
}

impl<'a> Compiler<'a> {
    fn function(
        &mut self,
        function: &'a Function,
        names: HashMap<&'static str, Name>,
    ) -> Result<(), String> {
        let body = function.body.as_ref().ok_or("a function has no body")?;
        self.open(body);
        let scope = self.scopes.last_mut().expect("it was opened");
        scope.names = names;
        scope.is_function = true;
        let end = self.label();
        self.ends.push(end);
        for (at, statement) in body.iter().enumerate() {
            self.statement(statement, &body[at + 1..])?;
        }
        self.ends.pop();
        self.scopes.pop();
        self.labels[end as usize] = self.steps.len() as u32;
        if self.ends.is_empty() {
            self.step(Op::Exit, None);
        }
        Ok(())
    }

    fn label(&mut self) -> u32 {
        self.labels.push(u32::MAX);
        self.labels.len() as u32 - 1
    }

    /// A scope with the labels that are in it.
    fn open(&mut self, statements: &'a [Statement]) {
        let mut scope = Scope::default();
        let mut depth = 0;
        for statement in statements {
            match statement {
                Statement::Open => depth += 1,
                Statement::Close if depth == 0 => break,
                Statement::Close => depth -= 1,
                Statement::Label(name) if depth == 0 => {
                    scope.labels.insert(name, self.label());
                }
                Statement::Targets { name, labels } if depth == 0 => {
                    scope.targets.insert(name, labels.clone());
                }
                _ => {}
            }
        }
        self.scopes.push(scope);
    }

    fn statement(&mut self, statement: &'a Statement, rest: &'a [Statement]) -> Result<(), String> {
        match statement {
            Statement::Open => self.open(rest),
            Statement::Close => {
                self.scopes.pop();
            }
            Statement::Label(name) => {
                let label = self.find_label(name).ok_or("a label is not known")?;
                self.labels[label as usize] = self.steps.len() as u32;
            }
            Statement::Registers { kind, names } => self.declare(kind, names)?,
            Statement::Variable(variable) => {
                let name = match variable.space {
                    ".shared" => Name::Shared(self.place_shared(variable)),
                    ".local" | ".param" => {
                        Name::Local(self.place_local(variable.bytes, variable.align))
                    }
                    other => return Err(format!("`{other}` within functions is not known")),
                };
                self.scope().names.insert(variable.name, name);
            }
            Statement::Targets { .. } => {}
            Statement::Instruction(instruction) => self.instruction(instruction)?,
        }
        Ok(())
    }

    fn scope(&mut self) -> &mut Scope {
        self.scopes.last_mut().expect("a function's scope is open")
    }

    fn declare(&mut self, kind: &str, names: &[(&'static str, Option<u32>)]) -> Result<(), String> {
        let wide =
            bytes_of(kind).ok_or_else(|| format!("registers of `{kind}` are not known"))? == 8;
        for &(name, count) in names {
            for index in 0..count.unwrap_or(1) {
                let place = self.register(wide);
                let entry = if kind == ".pred" {
                    Name::Predicate(place.slot)
                } else {
                    Name::Register(place)
                };
                let name = match count {
                    // Names are kept with the text.
                    Some(_) => &*format!("{name}{index}").leak(),
                    None => name,
                };
                self.scope().names.insert(name, entry);
            }
        }
        Ok(())
    }

    fn register(&mut self, wide: bool) -> Place {
        let slot = self.registers;
        self.registers += if wide { 2 } else { 1 };
        Place { slot, wide }
    }

    fn place_shared(&mut self, variable: &Variable) -> usize {
        let at = self.shared.next_multiple_of(variable.align);
        self.shared = at + variable.bytes;
        at
    }

    fn place_local(&mut self, bytes: usize, align: usize) -> usize {
        let at = self.local.next_multiple_of(align);
        self.local = (at + bytes).next_multiple_of(8);
        at
    }

    fn find(&mut self, name: &str) -> Option<Name> {
        for scope in self.scopes.iter().rev() {
            if let Some(&found) = scope.names.get(name) {
                return Some(found);
            }
            if scope.is_function {
                break;
            }
        }
        if let Some(slot) = SPECIAL.iter().position(|&special| special == name) {
            return Some(Name::Register(Place {
                slot: slot as u32,
                wide: false,
            }));
        }
        if name == "WARP_SZ" {
            let place = self.constant(Value::Number(LANES as u64), false);
            return Some(Name::Register(place));
        }
        if let Some(&address) = self.module.places.get(name) {
            return Some(Name::Global(address));
        }
        let variable = self
            .module
            .variables
            .get(name)
            .filter(|variable| variable.space == ".shared")?;
        if variable.bytes == 0 {
            self.dynamic_align = self.dynamic_align.max(variable.align);
            return Some(Name::DynamicShared);
        }
        if let Some(&at) = self.shared_variables.get(name) {
            return Some(Name::Shared(at));
        }
        let at = self.place_shared(variable);
        self.shared_variables.insert(variable.name, at);
        Some(Name::Shared(at))
    }

    fn find_label(&self, name: &str) -> Option<u32> {
        for scope in self.scopes.iter().rev() {
            if let Some(&label) = scope.labels.get(name) {
                return Some(label);
            }
            if scope.is_function {
                break;
            }
        }
        None
    }

    fn step(&mut self, op: Op, guard: Option<(u32, bool)>) {
        self.steps.push(Step {
            op,
            guard,
            line: self.line,
        });
    }

    fn constant(&mut self, value: Value, wide: bool) -> Place {
        if let Some(&place) = self.constants.get(&(value, wide)) {
            return place;
        }
        let place = self.register(wide);
        self.constants.insert((value, wide), place);
        place
    }

    fn instruction(&mut self, instruction: &'a Instruction) -> Result<(), String> {
        self.line = instruction.line;
        let guard = match instruction.guard {
            None => None,
            Some((name, negate)) => match self.find(name) {
                Some(Name::Predicate(slot)) => Some((slot, negate)),
                _ => return Err(format!("`{name}` is no predicate")),
            },
        };
        let mut parts = instruction.opcode.split('.');
        let base = parts.next().unwrap_or_default();
        if base == "call" {
            return self.call(&instruction.operands, guard);
        }
        let mut line = Line {
            compiler: self,
            operands: &instruction.operands,
            words: parts.collect(),
        };
        let op = line
            .op(base)
            .filter(|_| line.words.is_empty())
            .unwrap_or(Op::Unknown);
        self.step(op, guard);
        Ok(())
    }

    /// The function's steps, with its parameters being the caller's variables.
    fn call(&mut self, operands: &'a [Operand], guard: Option<(u32, bool)>) -> Result<(), String> {
        let (results, name, given): (&[Operand], _, &[Operand]) = match operands {
            [
                Operand::Group(results),
                Operand::Name(name),
                Operand::Group(given),
            ] => (results, name, given),
            [Operand::Group(results), Operand::Name(name)] => (results, name, &[]),
            [Operand::Name(name), Operand::Group(given)] => (&[], name, given),
            [Operand::Name(name)] => (&[], name, &[]),
            _ => {
                self.step(Op::Unknown, guard);
                return Ok(());
            }
        };
        let function = self
            .module
            .functions
            .get(name)
            .filter(|function| function.body.is_some());
        let Some(function) = function.filter(|_| self.ends.len() < DEPTH) else {
            self.step(Op::Unknown, guard);
            return Ok(());
        };
        let mut names = HashMap::new();
        let declared = function.results.iter().chain(&function.parameters);
        for (variable, operand) in declared.zip(results.iter().chain(given)) {
            let Operand::Name(name) = operand else {
                return Err("what a function is given has no name".into());
            };
            names.insert(
                variable.name,
                self.find(name)
                    .ok_or_else(|| format!("`{name}` is not known"))?,
            );
        }
        let after = self.label();
        if let Some((slot, negate)) = guard {
            self.step(Op::Jump(after), Some((slot, !negate)));
        }
        self.function(function, names)?;
        self.labels[after as usize] = self.steps.len() as u32;
        Ok(())
    }
}
