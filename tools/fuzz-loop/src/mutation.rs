//! Inputs that are nearly files: each is a function of a seed and a number, so that a failure can
//! be repeated.

use crate::Format;
use random::SplitMix64;

/// Longest input, in bytes: faults show in small ones, and small ones are fast.
const BYTES_MAX: usize = 1 << 16;

/// The values at which lengths, sizes and counts break.
const EDGES: [u64; 12] = [
    0,
    1,
    2,
    0x7f,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0xffff_ffff,
    0x4000,
    0x7fff_ffff_ffff_ffff,
    0xffff_ffff_ffff_ffff,
];

/// Random choices.
struct Random(SplitMix64);

impl Random {
    /// From 0 to `n` - 1; 0 if that is none.
    fn below(&mut self, n: usize) -> usize {
        (self.0.bits() % n.max(1) as u64) as usize
    }

    /// Of a stretch: from 1 to 256, mostly short.
    fn length(&mut self) -> usize {
        let n_bits = 1 + self.below(8);
        1 + self.below(1 << n_bits)
    }

    fn of<'a, T>(&mut self, choices: &'a [T]) -> &'a T {
        &choices[self.below(choices.len())]
    }
}

/// The input of a number. The first ones are the files themselves; every 64th is no file at all.
#[must_use]
pub fn input(format: &Format, files: &[Vec<u8>], seed: u64, number: u64) -> Vec<u8> {
    if let Some(file) = files.get(number as usize) {
        return file.clone();
    }
    let mut random = Random(SplitMix64(
        seed ^ number.wrapping_mul(0xd134_2543_de82_ef95),
    ));
    if number.is_multiple_of(64) {
        let n_bytes = random.below(300);
        return (0..n_bytes).map(|_| random.0.byte()).collect();
    }
    let mut bytes = random.of(files).clone();
    // Mostly few changes: after many, the first one is where reading ends.
    let n_changes = 1 << random.below(4);
    for _ in 0..n_changes {
        change(&mut bytes, format, files, &mut random);
    }
    bytes.truncate(BYTES_MAX);
    bytes
}

fn change(bytes: &mut Vec<u8>, format: &Format, files: &[Vec<u8>], random: &mut Random) {
    let at = random.below(bytes.len());
    let end = (at + random.length()).min(bytes.len());
    match random.below(10) {
        0 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
        1 if !bytes.is_empty() => bytes[at] = random.0.byte(),
        2 => overwrite_number(bytes, at, random),
        3 => drop(bytes.drain(at..end)),
        4 => {
            let again = bytes[at..end].to_vec();
            bytes.splice(at..at, again);
        }
        5 => bytes.truncate(at),
        6 => {
            let other = &files[random.below(files.len())];
            splice(bytes, at..end, other, random);
        }
        7 => {
            let fill = random.0.byte();
            bytes[at..end].fill(fill);
        }
        8 => replace_digits(bytes, at, random),
        _ if !format.words.is_empty() => {
            let word = random.of(format.words).bytes();
            // In the place of something, or between.
            let end = if random.below(2) == 0 { at } else { end };
            bytes.splice(at..end, word);
        }
        _ => {}
    }
}

/// A number of 1, 2, 4 or 8 bytes, in either order, becomes an edge.
fn overwrite_number(bytes: &mut [u8], at: usize, random: &mut Random) {
    let n_bytes = 1 << random.below(4);
    let edge = *random.of(&EDGES);
    let little = edge.to_le_bytes();
    let mut number = little[..n_bytes].to_vec();
    if random.below(2) == 0 {
        number.reverse();
    }
    for (byte, new) in bytes.iter_mut().skip(at).zip(number) {
        *byte = new;
    }
}

/// The stretch becomes one of another file.
fn splice(bytes: &mut Vec<u8>, stretch: std::ops::Range<usize>, other: &[u8], random: &mut Random) {
    let from = random.below(other.len());
    let to = (from + random.length()).min(other.len());
    bytes.splice(stretch, other[from..to].iter().copied());
}

/// The next number in digits becomes another.
fn replace_digits(bytes: &mut Vec<u8>, from: usize, random: &mut Random) {
    let Some(start) = (from..bytes.len()).find(|&i| bytes[i].is_ascii_digit()) else {
        return;
    };
    let n_digits = bytes[start..]
        .iter()
        .take_while(|b| b.is_ascii_digit())
        .count();
    let new = match random.below(3) {
        0 => random.of(&EDGES).to_string(),
        1 => random.below(300).to_string(),
        _ => "9".repeat(random.below(400)),
    };
    bytes.splice(start..start + n_digits, new.bytes());
}
