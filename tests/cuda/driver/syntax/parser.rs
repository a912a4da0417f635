//! From words to variables, functions and statements.

use super::tokens::{Token, tokens};
use super::{Function, Instruction, Module, Number, Operand, Statement, Variable, bytes_of};

type Result<T> = std::result::Result<T, String>;

struct Parser {
    tokens: Vec<Token>,
    at: usize,
}

pub(crate) fn parse(text: &'static str) -> Result<Module> {
    let mut parser = Parser {
        tokens: tokens(text)?,
        at: 0,
    };
    let mut module = Module {
        lines: text.lines().collect(),
        ..Module::default()
    };
    parser.module(&mut module).map_err(|problem| {
        let line = parser
            .tokens
            .get(parser.at.saturating_sub(1))
            .map_or(0, |token| token.line);
        format!("line {line} of the PTX: {problem}")
    })?;
    Ok(module)
}

impl Parser {
    fn peek(&self) -> &'static str {
        self.tokens.get(self.at).map_or("", |token| token.text)
    }

    fn next(&mut self) -> Result<&'static str> {
        let token = self.tokens.get(self.at).ok_or("the text ends too early")?;
        self.at += 1;
        Ok(token.text)
    }

    fn take(&mut self, text: &str) -> bool {
        let is_there = self.peek() == text;
        self.at += usize::from(is_there);
        is_there
    }

    fn expect(&mut self, text: &str) -> Result<()> {
        let found = self.next()?;
        if found == text {
            Ok(())
        } else {
            Err(format!("`{found}` in place of `{text}`"))
        }
    }

    /// All up to and with `end`, unread.
    fn skip_to(&mut self, end: &str) -> Result<()> {
        while self.next()? != end {}
        Ok(())
    }

    fn skip_line(&mut self) {
        let line = self.tokens[self.at - 1].line;
        while self
            .tokens
            .get(self.at)
            .is_some_and(|token| token.line == line)
        {
            self.at += 1;
        }
    }

    fn whole(&mut self) -> Result<i128> {
        match self.number()? {
            Number::Whole(value) => Ok(value),
            _ => Err("not a whole number".into()),
        }
    }

    fn number(&mut self) -> Result<Number> {
        let negative = self.take("-");
        let text = self.next()?;
        let bad = |_| format!("`{text}` is no number");
        let digits = text.trim_end_matches('U');
        let hexadecimal = |from: usize| u64::from_str_radix(&digits[from..], 16).map_err(bad);
        Ok(match digits.get(..2).unwrap_or_default() {
            "0f" | "0F" => Number::F32(hexadecimal(2)? as u32),
            "0d" | "0D" => Number::F64(hexadecimal(2)?),
            start => {
                let value = match start {
                    "0x" | "0X" => i128::from(hexadecimal(2)?),
                    _ => digits.parse().map_err(bad)?,
                };
                Number::Whole(if negative { -value } else { value })
            }
        })
    }

    fn module(&mut self, module: &mut Module) -> Result<()> {
        while self.at < self.tokens.len() {
            match self.next()? {
                ".version" | ".target" | ".address_size" | ".file" => self.skip_line(),
                ".visible" | ".extern" | ".weak" | ".common" => {}
                ".pragma" => self.skip_to(";")?,
                kind @ (".entry" | ".func") => {
                    let (name, function) = self.function(kind == ".entry")?;
                    // A declaration may follow the definition.
                    if function.body.is_some() || !module.functions.contains_key(name) {
                        module.functions.insert(name, function);
                    }
                }
                space @ (".global" | ".const" | ".shared") => {
                    let variable = self.variable(space)?;
                    self.expect(";")?;
                    module.variables.insert(variable.name, variable);
                }
                other => return Err(format!("`{other}` is not known")),
            }
        }
        Ok(())
    }

    /// What follows the space.
    fn variable(&mut self, space: &'static str) -> Result<Variable> {
        let mut variable = Variable {
            space,
            ..Variable::default()
        };
        let (mut size, mut elements) = (None, 1);
        loop {
            match self.next()? {
                ".align" => variable.align = self.whole()? as usize,
                ".ptr" | ".global" | ".const" | ".shared" | ".local" => {}
                ".v2" => elements = 2,
                ".v4" => elements = 4,
                kind if kind.starts_with('.') && size.is_none() => {
                    size = Some(bytes_of(kind).ok_or_else(|| format!("`{kind}` is no type"))?);
                }
                other if other.starts_with('.') => return Err(format!("`{other}` is not known")),
                name => {
                    variable.name = name;
                    break;
                }
            }
        }
        let size = size.ok_or("a variable has no type")?;
        // `.ptr .align` is about what a parameter points to.
        variable.align = if space == ".param" {
            variable.align.max(1)
        } else {
            variable.align.max(size)
        };
        while self.take("[") {
            elements *= if self.peek() == "]" {
                0
            } else {
                self.whole()? as usize
            };
            self.expect("]")?;
        }
        variable.bytes = size * elements;
        if self.take("=") {
            let is_list = self.take("{");
            while is_list || variable.start.is_empty() {
                let value = match self.number()? {
                    Number::Whole(value) => value as u64,
                    Number::F32(bits) => bits.into(),
                    Number::F64(bits) => bits,
                };
                variable
                    .start
                    .extend_from_slice(&value.to_le_bytes()[..size]);
                if is_list && !self.take(",") {
                    self.expect("}")?;
                    break;
                }
            }
        }
        Ok(variable)
    }

    fn parameters(&mut self) -> Result<Vec<Variable>> {
        let mut found = Vec::new();
        self.expect("(")?;
        while !self.take(")") {
            self.expect(".param")?;
            found.push(self.parameter()?);
            self.take(",");
        }
        Ok(found)
    }

    /// A parameter lies at multiples of its type or, of an array, of what it says.
    fn parameter(&mut self) -> Result<Variable> {
        let is_array = self.peek() == ".align";
        let mut parameter = self.variable(".param")?;
        if !is_array {
            parameter.align = parameter.bytes;
        }
        Ok(parameter)
    }

    fn function(&mut self, is_entry: bool) -> Result<(&'static str, Function)> {
        let mut function = Function {
            is_entry,
            ..Function::default()
        };
        if self.peek() == "(" {
            function.results = self.parameters()?;
        }
        let name = self.next()?;
        if self.peek() == "(" {
            function.parameters = self.parameters()?;
        }
        loop {
            match self.next()? {
                ";" => return Ok((name, function)),
                "{" => break,
                ".maxntid" | ".reqntid" => {
                    let mut threads = self.whole()?;
                    while self.take(",") {
                        threads *= self.whole()?;
                    }
                    function.threads = Some(threads as u32);
                }
                ".minnctapersm" | ".maxnreg" => {
                    self.whole()?;
                }
                ".noreturn" => {}
                other => return Err(format!("`{other}` is not known")),
            }
        }
        function.body = Some(self.body()?);
        Ok((name, function))
    }

    fn body(&mut self) -> Result<Vec<Statement>> {
        let (mut body, mut depth) = (Vec::new(), 1);
        while depth > 0 {
            let line = self.tokens.get(self.at).map_or(0, |token| token.line);
            match self.next()? {
                "{" => {
                    depth += 1;
                    body.push(Statement::Open);
                }
                "}" => {
                    depth -= 1;
                    if depth > 0 {
                        body.push(Statement::Close);
                    }
                }
                ";" => {}
                ".loc" => self.skip_line(),
                ".pragma" => self.skip_to(";")?,
                ".reg" => {
                    let kind = self.next()?;
                    body.push(self.registers(kind)?);
                }
                // Without a space between them.
                word if word.starts_with(".reg.") => body.push(self.registers(&word[4..])?),
                ".param" => body.push(Statement::Variable(self.parameter()?)),
                space @ (".shared" | ".local" | ".global" | ".const") => {
                    body.push(Statement::Variable(self.variable(space)?));
                }
                "@" => {
                    let negate = self.take("!");
                    let guard = Some((self.next()?, negate));
                    let opcode = self.next()?;
                    body.push(self.instruction(line, guard, opcode)?);
                }
                label if self.peek() == ":" => {
                    self.next()?;
                    if self.take(".branchtargets") {
                        let mut labels = vec![self.next()?];
                        while self.take(",") {
                            labels.push(self.next()?);
                        }
                        body.push(Statement::Targets {
                            name: label,
                            labels,
                        });
                    } else {
                        body.push(Statement::Label(label));
                    }
                }
                opcode => body.push(self.instruction(line, None, opcode)?),
            }
        }
        Ok(body)
    }

    fn registers(&mut self, kind: &'static str) -> Result<Statement> {
        let mut names = Vec::new();
        while names.is_empty() || self.take(",") {
            let name = self.next()?;
            let mut count = None;
            if self.take("<") {
                count = Some(self.whole()? as u32);
                self.expect(">")?;
            }
            names.push((name, count));
        }
        Ok(Statement::Registers { kind, names })
    }

    fn instruction(
        &mut self,
        line: u32,
        guard: Option<(&'static str, bool)>,
        opcode: &'static str,
    ) -> Result<Statement> {
        let operands = self.operands(";")?;
        Ok(Statement::Instruction(Instruction {
            line,
            guard,
            opcode,
            operands,
        }))
    }

    /// A list up to and with `end`.
    fn operands(&mut self, end: &str) -> Result<Vec<Operand>> {
        let mut found = Vec::new();
        while !self.take(end) {
            found.push(self.operand()?);
            if self.peek() != end {
                self.expect(",")?;
            }
        }
        Ok(found)
    }

    fn operand(&mut self) -> Result<Operand> {
        if self
            .peek()
            .starts_with(|first: char| first.is_ascii_digit() || first == '-')
        {
            return Ok(Operand::Number(self.number()?));
        }
        Ok(match self.next()? {
            "{" => Operand::Vector(self.operands("}")?),
            "(" => Operand::Group(self.operands(")")?),
            "!" => Operand::Not(self.next()?),
            "[" => {
                let base = self.operand()?;
                // Both `+4` and `+-4` are written.
                let offset = match self.peek() {
                    "+" => {
                        self.next()?;
                        self.whole()?
                    }
                    "-" => self.whole()?,
                    _ => 0,
                };
                self.expect("]")?;
                Operand::Address(Box::new(base), offset as i64)
            }
            name if self.take("|") => Operand::Pair(name, self.next()?),
            name => Operand::Name(name),
        })
    }
}
