//! Huffman tables: those of the standard (T.81, K.3), and lookup tables for any code.

use crate::image::jpeg::HUFFMAN_TABLES;

/// Maximum code length that a single lookup decodes. All frequent codes are shorter.
const LOOKUP_BITS: u32 = 9;

/// A Huffman table for decoding.
#[derive(Clone)]
pub(super) struct Table {
    /// Indexed by the next bits: the length of the code they start with times 256, plus its symbol;
    /// 0 if the code is longer.
    lookup: [u16; 1 << LOOKUP_BITS],
    /// Indexed by length: the first code that is too large, shifted up to 16 bits.
    limit: [u32; 17],
    /// Indexed by length: the offset from a code to the index of its symbol.
    offset: [i32; 17],
    symbols: Vec<u8>,
}

impl Table {
    /// The table with the given number of codes of each length from 1 to 16, and their symbols;
    /// `None` if there are more codes than the lengths allow, or the number of symbols differs.
    fn new(counts: &[u8; 16], symbols: &[u8]) -> Option<Self> {
        let mut table = Self {
            lookup: [0; 1 << LOOKUP_BITS],
            limit: [0; 17],
            offset: [0; 17],
            symbols: symbols.to_vec(),
        };
        let (mut code, mut first) = (0_u32, 0_usize);
        for (length, &count) in (1_u32..).zip(counts) {
            let codes = symbols.get(first..first + usize::from(count))?;
            table.offset[length as usize] = first as i32 - code as i32;
            for &symbol in codes {
                if length <= LOOKUP_BITS {
                    let begin = (code as usize) << (LOOKUP_BITS - length);
                    let end = (code as usize + 1) << (LOOKUP_BITS - length);
                    let entry = (length as u16) << 8 | u16::from(symbol);
                    table.lookup.get_mut(begin..end)?.fill(entry);
                }
                code += 1;
            }
            if code > 1 << length {
                return None;
            }
            table.limit[length as usize] = code << (16 - length);
            first += codes.len();
            code <<= 1;
        }
        Some(table)
    }

    /// Length and symbol of the code at the start of 16 bits; `None` if there is no such code.
    #[inline]
    pub(super) fn decode(&self, bits: u32) -> Option<(u32, u8)> {
        let entry = self.lookup[(bits >> (16 - LOOKUP_BITS)) as usize & ((1 << LOOKUP_BITS) - 1)];
        if entry != 0 {
            return Some((u32::from(entry >> 8), entry as u8));
        }
        let length = (LOOKUP_BITS + 1..=16).find(|&length| bits < self.limit[length as usize])?;
        let index = (bits >> (16 - length)) as i32 + self.offset[length as usize];
        let symbol = self.symbols.get(usize::try_from(index).ok()?)?;
        Some((length, *symbol))
    }
}

/// The current tables: four each for DC and AC.
pub(super) type Tables = [[Option<Table>; 4]; 2];

/// Reads a segment that defines tables; `None` if it is damaged.
pub(super) fn define(tables: &mut Tables, mut content: &[u8]) -> Option<()> {
    while let Some((&id, rest)) = content.split_first() {
        let (counts, rest) = rest.split_first_chunk::<16>()?;
        let n_symbols = counts.iter().map(|&count| usize::from(count)).sum();
        let (symbols, rest) = rest.split_at_checked(n_symbols)?;
        let table = tables
            .get_mut(usize::from(id >> 4))?
            .get_mut(usize::from(id & 15))?;
        *table = Some(Table::new(counts, symbols)?);
        content = rest;
    }
    Some(())
}

/// Symbols of the standard's Huffman tables by code length, from 1 bit (T.81, tables K.3 to K.6).
///
/// For the AC tables, 16-bit codes are not listed: they stand for all other symbols, in ascending
/// order. The symbols are those of baseline coding: end of block (00), sixteen zeros (f0), and run
/// of zeros 0 to 15 times magnitude category 1 to 10.
const DC_LUMA: [&[u8]; 9] = [
    &[],
    &[0],
    &[1, 2, 3, 4, 5],
    &[6],
    &[7],
    &[8],
    &[9],
    &[10],
    &[11],
];
const DC_CHROMA: [&[u8]; 11] = [
    &[],
    &[0, 1, 2],
    &[3],
    &[4],
    &[5],
    &[6],
    &[7],
    &[8],
    &[9],
    &[10],
    &[11],
];
const AC_LUMA: [&[u8]; 15] = [
    &[],
    &[0x01, 0x02],
    &[0x03],
    &[0x00, 0x04, 0x11],
    &[0x05, 0x12, 0x21],
    &[0x31, 0x41],
    &[0x06, 0x13, 0x51, 0x61],
    &[0x07, 0x22, 0x71],
    &[0x14, 0x32, 0x81, 0x91, 0xa1],
    &[0x08, 0x23, 0x42, 0xb1, 0xc1],
    &[0x15, 0x52, 0xd1, 0xf0],
    &[0x24, 0x33, 0x62, 0x72],
    &[],
    &[],
    &[0x82],
];
const AC_CHROMA: [&[u8]; 15] = [
    &[],
    &[0x00, 0x01],
    &[0x02],
    &[0x03, 0x11],
    &[0x04, 0x05, 0x21, 0x31],
    &[0x06, 0x12, 0x41, 0x51],
    &[0x07, 0x61, 0x71],
    &[0x13, 0x22, 0x32, 0x81],
    &[0x08, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1],
    &[0x09, 0x23, 0x33, 0x52, 0xf0],
    &[0x15, 0x62, 0x72, 0xd1],
    &[0x0a, 0x16, 0x24, 0x34],
    &[],
    &[0xe1],
    &[0x25, 0xf1],
];

/// A segment that defines all four standard tables.
pub(super) fn standard_tables() -> Vec<u8> {
    let mut tables = Vec::with_capacity(418);
    // Class (0 DC, 1 AC) and index of each table.
    for (id, by_length) in [
        (0x00, &DC_LUMA[..]),
        (0x10, &AC_LUMA),
        (0x01, &DC_CHROMA),
        (0x11, &AC_CHROMA),
    ] {
        let listed = by_length.concat();
        let is_ac = id & 0x10 != 0;
        let others: Vec<u8> = (0..=u8::MAX)
            .filter(|symbol| is_ac && (1..=10).contains(&(symbol & 0x0f)))
            .filter(|symbol| !listed.contains(symbol))
            .collect();
        let n_others = others.len() as u8;
        let n_of_length = |i: usize| by_length.get(i).map_or(0, |symbols| symbols.len() as u8);
        tables.push(id);
        tables.extend((0..15).map(n_of_length));
        tables.push(n_others);
        tables.extend(listed);
        tables.extend(others);
    }
    let segment_bytes = (2 + tables.len()) as u16;
    [
        &[0xff, HUFFMAN_TABLES],
        &segment_bytes.to_be_bytes()[..],
        &tables,
    ]
    .concat()
}
