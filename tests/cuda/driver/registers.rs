//! Registers of the threads of a warp: each is an array over the threads.

use crate::number::{Bf16, F16, Half};

/// Threads in a warp.
pub(crate) const LANES: usize = 32;

/// Threads of a warp, a bit for each.
pub(crate) type Mask = u32;

pub(crate) const ALL: Mask = Mask::MAX;

/// A register of up to 32 bits; those of 64 bits are two of these. A predicate is a [`Mask`] in the first number.
#[repr(C, align(128))]
#[derive(Clone, Copy)]
struct Register([u32; LANES]);

pub(crate) struct Registers(Vec<Register>);

/// What a register is read and written as.
pub(crate) trait Lane: Copy + Default + 'static {
    type Word: Copy;
    fn read(word: Self::Word) -> Self;
    fn word(self) -> Self::Word;
    /// From the lower bits of 64.
    fn narrow(bits: u64) -> Self;
    /// In 64 bits: a signed number remains the number that it is.
    fn wide(self) -> u64;
}

macro_rules! lanes {
    ($($type:ty: $word:ty, $read:expr, $write:expr, $wide:expr;)*) => {
        $(impl Lane for $type {
            type Word = $word;
            fn read(word: $word) -> Self {
                ($read)(word)
            }
            fn word(self) -> $word {
                ($write)(self)
            }
            fn narrow(bits: u64) -> Self {
                ($read)(bits as $word)
            }
            fn wide(self) -> u64 {
                ($wide)(self)
            }
        })*
    };
}

lanes! {
    u8: u32, |word| word as u8, |value| value as u32, |value| value as u64;
    i8: u32, |word| word as i8, |value| value as u32, |value| value as u64;
    u16: u32, |word| word as u16, |value| value as u32, |value| value as u64;
    i16: u32, |word| word as i16, |value| value as u32, |value| value as u64;
    u32: u32, |word| word, |value| value, |value| value as u64;
    i32: u32, |word| word as i32, |value| value as u32, |value| value as u64;
    f32: u32, f32::from_bits, f32::to_bits, |value: f32| value.to_bits().into();
    u64: u64, |word| word, |value| value, |value| value;
    i64: u64, |word| word as i64, |value| value as u64, |value| value as u64;
    f64: u64, f64::from_bits, f64::to_bits, f64::to_bits;
    F16: u32, |word| F16(word as u16), |value: F16| value.0.into(), |value: F16| value.0.into();
    Bf16: u32, |word| Bf16(word as u16), |value: Bf16| value.0.into(), |value: Bf16| value.0.into();
}

/// Two numbers of 16 bits in one register, the first in its lower half.
#[derive(Clone, Copy, Default)]
pub(crate) struct Two<H>(pub(crate) H, pub(crate) H);

impl<H: Half> Lane for Two<H> {
    type Word = u32;

    fn read(word: u32) -> Self {
        Self(H::from_bits(word as u16), H::from_bits((word >> 16) as u16))
    }

    fn word(self) -> u32 {
        u32::from(self.0.bits()) | u32::from(self.1.bits()) << 16
    }

    fn narrow(bits: u64) -> Self {
        Self::read(bits as u32)
    }

    fn wide(self) -> u64 {
        self.word().into()
    }
}

impl Registers {
    pub(crate) fn new(count: u32) -> Self {
        Self(vec![Register([0; LANES]); count as usize])
    }

    pub(crate) fn words<T: Lane>(&self, slot: u32) -> &[T::Word; LANES] {
        let taken = size_of::<T::Word>() / size_of::<u32>();
        let slots = &self.0[slot as usize..slot as usize + taken];
        // Safe: words are u32 or u64, and as many as fit.
        unsafe { &*slots.as_ptr().cast() }
    }

    fn words_mut<T: Lane>(&mut self, slot: u32) -> &mut [T::Word; LANES] {
        let taken = size_of::<T::Word>() / size_of::<u32>();
        let slots = &mut self.0[slot as usize..slot as usize + taken];
        // Safe as in `words`.
        unsafe { &mut *slots.as_mut_ptr().cast() }
    }

    pub(crate) fn get<T: Lane>(&self, slot: u32) -> [T; LANES] {
        let words = self.words::<T>(slot);
        let mut values = [T::default(); LANES];
        for lane in 0..LANES {
            values[lane] = T::read(words[lane]);
        }
        values
    }

    pub(crate) fn set<T: Lane>(&mut self, slot: u32, values: &[T; LANES], mask: Mask) {
        let words = self.words_mut::<T>(slot);
        if mask == ALL {
            for lane in 0..LANES {
                words[lane] = values[lane].word();
            }
            return;
        }
        for lane in 0..LANES {
            let is_active = mask >> lane & 1 == 1;
            words[lane] = if is_active {
                values[lane].word()
            } else {
                words[lane]
            };
        }
    }

    pub(crate) fn fill<T: Lane>(&mut self, slot: u32, value: T) {
        self.set(slot, &[value; LANES], ALL);
    }

    pub(crate) fn predicate(&self, slot: u32) -> Mask {
        self.0[slot as usize].0[0]
    }

    pub(crate) fn set_predicate(&mut self, slot: u32, bits: Mask, mask: Mask) {
        let word = &mut self.0[slot as usize].0[0];
        *word = *word & !mask | bits & mask;
    }
}
