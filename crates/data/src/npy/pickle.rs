//! Reads a pickle as data. Names in it are kept as names: nothing is imported or called
//! (`pickletools` of Python's standard library describes the opcodes of protocols 2 to 5).
//!
//! `pytorch_reader`, which reads the pickles of PyTorch files, drops the state of objects other than
//! tensors, and with it the numbers of NumPy's arrays.

use std::collections::HashMap;

/// Largest number of opcodes. Each adds at most one value, so memory is bounded too.
const MAX_STEPS: usize = 1 << 20;

/// The index of a value in [`Pickle::values`].
pub(super) type Place = usize;

/// A value; bytes and texts are those of the file.
#[derive(Debug)]
pub(super) enum Value<'a> {
    Int(i64),
    Text(&'a str),
    Bytes(&'a [u8]),
    Tuple(Vec<Place>),
    List(Vec<Place>),
    Dict(Vec<[Place; 2]>),
    /// A name and its module.
    Global(&'a str, &'a str),
    /// An object: its callable and arguments, and what `__setstate__` would be given.
    Object {
        callable: Place,
        arguments: Place,
        state: Option<Place>,
    },
    Bool(bool),
    /// None, a float, or an integer of more than 64 bits.
    Other,
}

/// The values of a pickle.
pub(super) struct Pickle<'a> {
    values: Vec<Value<'a>>,
    pub(super) root: Place,
}

impl<'a> Pickle<'a> {
    pub(super) fn at(&self, place: Place) -> &Value<'a> {
        &self.values[place]
    }

    /// Parses the pickle at the beginning of `bytes`. Fails with the reason.
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let mut machine = Machine {
            bytes,
            position: 0,
            values: Vec::new(),
            stack: Vec::new(),
            marks: Vec::new(),
            memo: HashMap::new(),
        };
        for _ in 0..MAX_STEPS {
            let position = machine.position;
            let code = machine.number::<1>()? as u8;
            match machine.step(code) {
                Ok(true) => {}
                Ok(false) => {
                    let root = machine.pop()?;
                    let values = machine.values;
                    return Ok(Self { values, root });
                }
                Err(reason) => return Err(format!("byte {position} of its pickle: {reason}")),
            }
        }
        Err(format!("its pickle has more than {MAX_STEPS} opcodes"))
    }
}

struct Machine<'a> {
    bytes: &'a [u8],
    position: usize,
    values: Vec<Value<'a>>,
    stack: Vec<Place>,
    /// Heights of the stack at the open marks.
    marks: Vec<usize>,
    memo: HashMap<u64, Place>,
}

impl<'a> Machine<'a> {
    /// Runs an opcode; false at the end of the pickle.
    fn step(&mut self, code: u8) -> Result<bool, String> {
        match code {
            b'.' => return Ok(false),
            // PROTO and FRAME.
            0x80 => drop(self.take(1)?),
            0x95 => drop(self.take(8)?),
            b'(' => self.marks.push(self.stack.len()),
            b'0' => drop(self.pop()?),
            b'1' => drop(self.above_mark()?),
            b'2' => {
                let top = self.top()?;
                self.stack.push(top);
            }
            b'N' => self.push(Value::Other),
            0x88 => self.push(Value::Bool(true)),
            0x89 => self.push(Value::Bool(false)),
            b'K' => self.unsigned::<1>()?,
            b'M' => self.unsigned::<2>()?,
            b'J' => {
                let number = self.number::<4>()? as u32;
                self.push(Value::Int(i64::from(number.cast_signed())));
            }
            0x8a => self.long()?,
            b'G' => {
                self.take(8)?;
                self.push(Value::Other);
            }
            0x8c => self.text::<1>()?,
            b'X' => self.text::<4>()?,
            0x8d => self.text::<8>()?,
            b'C' | b'U' => self.data::<1>()?,
            b'B' | b'T' => self.data::<4>()?,
            0x8e | 0x96 => self.data::<8>()?,
            b')' => self.push(Value::Tuple(Vec::new())),
            b']' => self.push(Value::List(Vec::new())),
            b'}' => self.push(Value::Dict(Vec::new())),
            b't' => {
                let items = self.above_mark()?;
                self.push(Value::Tuple(items));
            }
            b'l' => {
                let items = self.above_mark()?;
                self.push(Value::List(items));
            }
            b'd' => {
                let items = pairs(&self.above_mark()?)?;
                self.push(Value::Dict(items));
            }
            0x85..=0x87 => self.tuple_of(usize::from(code - 0x84))?,
            b'a' => {
                let item = self.pop()?;
                self.append(&[item])?;
            }
            b'e' => {
                let items = self.above_mark()?;
                self.append(&items)?;
            }
            b's' => {
                let value = self.pop()?;
                let key = self.pop()?;
                self.set(&[[key, value]])?;
            }
            b'u' => {
                let items = pairs(&self.above_mark()?)?;
                self.set(&items)?;
            }
            b'q' => self.remember::<1>()?,
            b'r' => self.remember::<4>()?,
            0x94 => {
                let top = self.top()?;
                self.memo.insert(self.memo.len() as u64, top);
            }
            b'h' => self.recall::<1>()?,
            b'j' => self.recall::<4>()?,
            b'c' => {
                let module = self.line()?;
                let name = self.line()?;
                self.push(Value::Global(module, name));
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                match (&self.values[module], &self.values[name]) {
                    (&Value::Text(module), &Value::Text(name)) => {
                        self.push(Value::Global(module, name));
                    }
                    _ => return Err("a name that is not text".to_owned()),
                }
            }
            // REDUCE and NEWOBJ.
            b'R' | 0x81 => {
                let (arguments, callable) = (self.pop()?, self.pop()?);
                self.push(Value::Object {
                    callable,
                    arguments,
                    state: None,
                });
            }
            b'b' => {
                let given = self.pop()?;
                let object = self.top()?;
                match &mut self.values[object] {
                    Value::Object { state, .. } => *state = Some(given),
                    _ => return Err("a state for a value that is not an object".to_owned()),
                }
            }
            _ => {
                return Err(format!(
                    "opcode 0x{code:02x} is not of arrays and dictionaries"
                ));
            }
        }
        Ok(true)
    }

    fn take(&mut self, count: u64) -> Result<&'a [u8], String> {
        let rest = &self.bytes[self.position..];
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        let found = rest.get(..count).ok_or("its pickle is cut off")?;
        self.position += count;
        Ok(found)
    }

    /// A little-endian number of N bytes.
    fn number<const N: usize>(&mut self) -> Result<u64, String> {
        let mut bytes = [0; 8];
        bytes[..N].copy_from_slice(self.take(N as u64)?);
        Ok(u64::from_le_bytes(bytes))
    }

    fn line(&mut self) -> Result<&'a str, String> {
        let rest = &self.bytes[self.position..];
        let end = rest.iter().position(|byte| *byte == b'\n');
        let end = end.ok_or("its pickle is cut off")?;
        self.position += end + 1;
        str::from_utf8(&rest[..end]).map_err(|_| "a name that is not text".to_owned())
    }

    fn push(&mut self, value: Value<'a>) {
        self.stack.push(self.values.len());
        self.values.push(value);
    }

    /// Removes the top of the stack, above the last mark.
    fn pop(&mut self) -> Result<Place, String> {
        let place = self.top()?;
        self.stack.pop();
        Ok(place)
    }

    fn top(&self) -> Result<Place, String> {
        let bottom = self.marks.last().copied().unwrap_or(0);
        let above = self.stack.get(bottom..).and_then(<[_]>::last);
        above.copied().ok_or_else(|| "an empty stack".to_owned())
    }

    /// Removes the values above the last mark, and the mark.
    fn above_mark(&mut self) -> Result<Vec<Place>, String> {
        let mark = self.marks.pop().ok_or("no mark")?;
        Ok(self.stack.split_off(mark))
    }

    fn unsigned<const N: usize>(&mut self) -> Result<(), String> {
        let number = self.number::<N>()?;
        self.push(Value::Int(number as i64));
        Ok(())
    }

    /// An integer in two's complement.
    fn long(&mut self) -> Result<(), String> {
        let count = self.number::<1>()?;
        let bytes = self.take(count)?;
        let sign = if bytes.last().is_some_and(|byte| *byte >= 0x80) {
            0xff
        } else {
            0
        };
        let value = match bytes.len() {
            0..=8 => {
                let mut all = [sign; 8];
                all[..bytes.len()].copy_from_slice(bytes);
                Value::Int(i64::from_le_bytes(all))
            }
            _ => Value::Other,
        };
        self.push(value);
        Ok(())
    }

    fn text<const N: usize>(&mut self) -> Result<(), String> {
        let count = self.number::<N>()?;
        let text = str::from_utf8(self.take(count)?);
        // Python allows lone surrogates, which UTF-8 does not.
        self.push(text.map_or(Value::Other, Value::Text));
        Ok(())
    }

    fn data<const N: usize>(&mut self) -> Result<(), String> {
        let count = self.number::<N>()?;
        let data = self.take(count)?;
        self.push(Value::Bytes(data));
        Ok(())
    }

    fn tuple_of(&mut self, count: usize) -> Result<(), String> {
        let bottom = self.marks.last().copied().unwrap_or(0);
        let first = self.stack.len().checked_sub(count);
        let first = first
            .filter(|first| *first >= bottom)
            .ok_or("an empty stack")?;
        let items = self.stack.split_off(first);
        self.push(Value::Tuple(items));
        Ok(())
    }

    fn append(&mut self, items: &[Place]) -> Result<(), String> {
        let list = self.top()?;
        match &mut self.values[list] {
            Value::List(all) => all.extend(items),
            // Lists of other types, such as subclasses.
            Value::Object { .. } => {}
            _ => return Err("items for a value that is not a list".to_owned()),
        }
        Ok(())
    }

    fn set(&mut self, items: &[[Place; 2]]) -> Result<(), String> {
        let dict = self.top()?;
        match &mut self.values[dict] {
            Value::Dict(all) => all.extend(items),
            Value::Object { .. } => {}
            _ => return Err("entries for a value that is not a dictionary".to_owned()),
        }
        Ok(())
    }

    fn remember<const N: usize>(&mut self) -> Result<(), String> {
        let (key, top) = (self.number::<N>()?, self.top()?);
        self.memo.insert(key, top);
        Ok(())
    }

    fn recall<const N: usize>(&mut self) -> Result<(), String> {
        let key = self.number::<N>()?;
        let place = self.memo.get(&key).copied();
        self.stack.push(place.ok_or("a value that was not stored")?);
        Ok(())
    }
}

fn pairs(items: &[Place]) -> Result<Vec<[Place; 2]>, String> {
    let (pairs, rest) = items.as_chunks();
    match rest.is_empty() {
        true => Ok(pairs.to_vec()),
        false => Err("a key without a value".to_owned()),
    }
}
