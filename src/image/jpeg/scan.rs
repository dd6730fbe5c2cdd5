//! Reads the coded data of a scan without decoding pixels, to check that they are complete and find
//! their end.
//!
//! Decoders fill missing data with grey, silently if an end marker follows. The only way to detect
//! this is to read every code (T.81, F.2 and G.2), as [`read`] does. It does not store
//! coefficients. For progressive images it stores which ones are not zero, because a refinement
//! scan has one bit for each of these.

use std::ops::Range;

use imgproc::Size;

use crate::image::jpeg::huffman::{Table, Tables};

/// Coding of the pixels, from the frame header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Coding {
    Sequential,
    Progressive,
    /// Arithmetic, lossless or hierarchical coding, which is not supported.
    Other,
}

/// A colour component of the frame header, and what has been read of it so far.
pub(super) struct Component {
    id: u8,
    /// Horizontal and vertical sampling factors: blocks per minimum coded unit.
    sampling: Size,
    /// Number of blocks of the component in a scan of its own.
    blocks: Size,
    /// Blocks in a row of [`Component::nonzero`].
    stride: usize,
    /// For a progressive image, one bit for each coefficient of each block, set if it is not zero.
    nonzero: Vec<u64>,
    /// The lowest bit read so far of each coefficient, initially [`UNREAD`].
    lowest_bit: [u8; 64],
}

const UNREAD: u8 = u8::MAX;

/// The frame header.
pub(super) struct FrameHeader {
    pub(super) size: Size,
    pub(super) coding: Coding,
    components: Vec<Component>,
    /// Number of minimum coded units in a scan with several components.
    units: Size,
}

/// Faults of the data of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ScanError {
    /// The data end before the last block.
    Short,
    /// The data are invalid; a short reason.
    Damaged(&'static str),
}

impl FrameHeader {
    /// Parses a frame header segment; `None` if it is damaged or the image has no pixels.
    pub(super) fn parse(marker: u8, content: &[u8]) -> Option<Self> {
        let coding = match marker {
            0xc0 | 0xc1 => Coding::Sequential,
            0xc2 => Coding::Progressive,
            _ => Coding::Other,
        };
        let (head, rest) = content.split_first_chunk::<6>()?;
        let size = Size {
            height: usize::from(u16::from_be_bytes([head[1], head[2]])),
            width: usize::from(u16::from_be_bytes([head[3], head[4]])),
        };
        let described = rest.get(..3 * usize::from(head[5]))?.as_chunks::<3>().0;
        let of = |component: &[u8; 3]| Size {
            width: usize::from(component[1] >> 4),
            height: usize::from(component[1] & 15),
        };
        let largest = described.iter().map(of).fold(ONE, |largest, of| Size {
            width: largest.width.max(of.width),
            height: largest.height.max(of.height),
        });
        let units = Size {
            width: size.width.div_ceil(8 * largest.width),
            height: size.height.div_ceil(8 * largest.height),
        };
        let component = |described: &[u8; 3]| {
            let sampling = of(described);
            let blocks = Size {
                width: (size.width * sampling.width).div_ceil(8 * largest.width),
                height: (size.height * sampling.height).div_ceil(8 * largest.height),
            };
            let stride = units.width * sampling.width;
            let n_blocks = match coding {
                Coding::Progressive => stride * units.height * sampling.height,
                _ => 0,
            };
            let is_possible =
                (1..=4).contains(&sampling.width) && (1..=4).contains(&sampling.height);
            is_possible.then(|| Component {
                id: described[0],
                sampling,
                blocks,
                stride,
                nonzero: vec![0; n_blocks],
                lowest_bit: [UNREAD; 64],
            })
        };
        let components = described
            .iter()
            .map(component)
            .collect::<Option<Vec<_>>>()?;
        let is_possible = size.area() > 0 && (1..=4).contains(&components.len());
        is_possible.then_some(Self {
            size,
            coding,
            components,
            units,
        })
    }

    /// Whether every coefficient was read to its last bit. Not meaningful for unsupported codings.
    pub(super) fn is_complete(&self) -> bool {
        let mut components = self.components.iter();
        self.coding == Coding::Other || components.all(|c| c.lowest_bit == [0; 64])
    }
}

const ONE: Size = Size {
    width: 1,
    height: 1,
};

/// A component in a scan.
struct Part<'a> {
    component: usize,
    dc: Option<&'a Table>,
    ac: Option<&'a Table>,
}

/// The coefficients of a scan, and their bits.
struct Band {
    coefficients: Range<usize>,
    /// Bits from this one up were sent before; none if 0.
    high: u8,
    low: u8,
}

/// Reads the data of a scan from `at`, and returns the position after them. Stray bytes are added
/// to `junk`: those after the last code before a marker, and fill bytes before a restart marker.
pub(super) fn read(
    jpeg: &[u8],
    at: usize,
    header: &[u8],
    frame: &mut FrameHeader,
    tables: &Tables,
    restart_interval: usize,
    junk: &mut Vec<Range<usize>>,
) -> Result<usize, ScanError> {
    let damaged = ScanError::Damaged;
    let (parts, band) = parse_header(header, frame, tables).ok_or(damaged("bad scan header"))?;
    for part in &parts {
        let lowest_bit = &mut frame.components[part.component].lowest_bit;
        lowest_bit[band.coefficients.clone()].fill(band.low);
    }
    let units = match parts[..] {
        [Part { component, .. }] => frame.components[component].blocks,
        _ => frame.units,
    };
    let mut bits = Bits::new(jpeg, at);
    let mut end_of_band_run = 0;
    for unit in 0..units.area() {
        if restart_interval > 0 && unit > 0 && unit % restart_interval == 0 {
            let number = (unit / restart_interval - 1) % 8;
            bits.restart(number as u8, junk)?;
            end_of_band_run = 0;
        }
        let at = (unit % units.width, unit / units.width);
        let read = read_unit(&mut bits, frame, &parts, &band, at, &mut end_of_band_run);
        if bits.ran_out() {
            return Err(ScanError::Short);
        }
        read.ok_or(damaged("a code that its tables do not have"))?;
    }
    Ok(bits.finish(junk))
}

fn parse_header<'a>(
    header: &[u8],
    frame: &FrameHeader,
    tables: &'a Tables,
) -> Option<(Vec<Part<'a>>, Band)> {
    let (&n_parts, rest) = header.split_first()?;
    let (described, rest) = rest.split_at_checked(2 * usize::from(n_parts))?;
    let &[first, last, bits] = rest.first_chunk::<3>()?;
    let part = |described: &[u8; 2]| {
        let [id, numbers] = *described;
        let table = |class: usize, number: u8| tables[class].get(usize::from(number))?.as_ref();
        Some(Part {
            component: frame.components.iter().position(|c| c.id == id)?,
            dc: table(0, numbers >> 4),
            ac: table(1, numbers & 15),
        })
    };
    let parts: Vec<Part> = described
        .as_chunks::<2>()
        .0
        .iter()
        .map(part)
        .collect::<Option<_>>()?;
    let band = match frame.coding {
        Coding::Progressive => Band {
            coefficients: usize::from(first)..usize::from(last) + 1,
            high: bits >> 4,
            low: bits & 15,
        },
        _ => Band {
            coefficients: 0..64,
            high: 0,
            low: 0,
        },
    };
    let Range { start, end } = band.coefficients;
    let is_possible = start < end
        && end <= 64
        && (1..=4).contains(&parts.len())
        // A progressive scan has the DC coefficients of several components, or AC coefficients of
        // one.
        && (frame.coding != Coding::Progressive || end == 1 || (start > 0 && parts.len() == 1));
    is_possible.then_some((parts, band))
}

/// Reads one minimum coded unit; `None` if a code is invalid.
fn read_unit(
    bits: &mut Bits,
    frame: &mut FrameHeader,
    parts: &[Part],
    band: &Band,
    (x, y): (usize, usize),
    end_of_band_run: &mut u32,
) -> Option<()> {
    let is_alone = parts.len() == 1;
    let is_progressive = frame.coding == Coding::Progressive;
    for part in parts {
        let component = &mut frame.components[part.component];
        let sampling = if is_alone { ONE } else { component.sampling };
        for _ in 0..sampling.area() {
            if !is_progressive {
                read_block(bits, part.dc?, part.ac?)?;
            } else if band.coefficients.start > 0 {
                let nonzero = component.nonzero.get_mut(y * component.stride + x)?;
                let ac = part.ac?;
                if band.high == 0 {
                    read_first(bits, ac, &band.coefficients, nonzero, end_of_band_run)?;
                } else {
                    read_refinement(bits, ac, &band.coefficients, nonzero, end_of_band_run)?;
                }
            } else if band.high == 0 {
                read_dc(bits, part.dc?)?;
            } else {
                bits.take(1);
            }
        }
    }
    Some(())
}

#[inline]
fn read_dc(bits: &mut Bits, dc: &Table) -> Option<()> {
    let n_bits = bits.decode(dc)?;
    if n_bits > 16 {
        return None;
    }
    bits.skip(u32::from(n_bits));
    Some(())
}

/// Reads all coefficients of a block of a sequential image.
fn read_block(bits: &mut Bits, dc: &Table, ac: &Table) -> Option<()> {
    read_dc(bits, dc)?;
    let mut k = 1;
    while k < 64 {
        let symbol = bits.decode(ac)?;
        let (run, n_bits) = (usize::from(symbol >> 4), u32::from(symbol & 15));
        bits.skip(n_bits);
        match (n_bits, run) {
            (0, 15) => k += 16,
            (0, _) => return Some(()),
            _ => k += run + 1,
        }
    }
    (k == 64).then_some(())
}

/// Reads the upper bits of a band of a block (T.81, G.1.2.2).
fn read_first(
    bits: &mut Bits,
    ac: &Table,
    band: &Range<usize>,
    nonzero: &mut u64,
    end_of_band_run: &mut u32,
) -> Option<()> {
    if *end_of_band_run > 0 {
        *end_of_band_run -= 1;
        return Some(());
    }
    let mut k = band.start;
    while k < band.end {
        let symbol = bits.decode(ac)?;
        let (run, n_bits) = (symbol >> 4, u32::from(symbol & 15));
        bits.skip(n_bits);
        match (n_bits, run) {
            (0, 15) => k += 16,
            (0, _) => {
                *end_of_band_run = (1 << run) - 1 + bits.take(u32::from(run));
                return Some(());
            }
            _ => {
                k += usize::from(run);
                *nonzero |= 1_u64.checked_shl(k as u32)?;
                k += 1;
            }
        }
    }
    (k == band.end).then_some(())
}

/// Reads one more bit of a band of a block (T.81, G.1.2.3).
fn read_refinement(
    bits: &mut Bits,
    ac: &Table,
    band: &Range<usize>,
    nonzero: &mut u64,
    end_of_band_run: &mut u32,
) -> Option<()> {
    let mut k = band.start;
    while k < band.end && *end_of_band_run == 0 {
        let symbol = bits.decode(ac)?;
        let (mut run, n_bits) = (symbol >> 4, symbol & 15);
        match (n_bits, run) {
            (0, 0..15) => {
                *end_of_band_run = (1 << run) + bits.take(u32::from(run));
                break;
            }
            (0 | 1, _) => bits.skip(u32::from(n_bits)),
            _ => return None,
        }
        while k < band.end {
            if *nonzero >> k & 1 != 0 {
                bits.take(1);
            } else if run == 0 {
                break;
            } else {
                run -= 1;
            }
            k += 1;
        }
        if n_bits == 1 {
            if k >= band.end {
                return None;
            }
            *nonzero |= 1 << k;
        }
        k += 1;
    }
    if *end_of_band_run > 0 {
        for k in k..band.end {
            if *nonzero >> k & 1 != 0 {
                bits.take(1);
            }
        }
        *end_of_band_run -= 1;
    }
    Some(())
}

/// Bit reader for coded data between two restart markers. After the end it returns zeros.
struct Bits<'a> {
    jpeg: &'a [u8],
    /// Position of the next byte that is not in the buffer.
    at: usize,
    /// The next bits, highest first.
    buffer: u64,
    /// Number of bits in the buffer.
    n_bits: u32,
    /// Number of these bits that are padding after the end. More than `n_bits` if some of them were
    /// consumed.
    n_missing: u32,
}

impl<'a> Bits<'a> {
    fn new(jpeg: &'a [u8], at: usize) -> Self {
        Self {
            jpeg,
            at,
            buffer: 0,
            n_bits: 0,
            n_missing: 0,
        }
    }

    /// The symbol of the next code; afterwards the buffer has at least 16 bits.
    #[inline]
    fn decode(&mut self, table: &Table) -> Option<u8> {
        if self.n_bits < 32 {
            self.fill();
        }
        let (length, symbol) = table.decode((self.buffer >> 48) as u32)?;
        self.skip(length);
        Some(symbol)
    }

    /// Consumes bits that are in the buffer.
    #[inline]
    fn skip(&mut self, n: u32) {
        self.buffer <<= n;
        self.n_bits -= n;
    }

    /// Returns the next `n` bits as a number, at most 16.
    #[inline]
    fn take(&mut self, n: u32) -> u32 {
        if n == 0 {
            return 0;
        }
        if self.n_bits < 32 {
            self.fill();
        }
        let bits = (self.buffer >> (64 - n)) as u32;
        self.skip(n);
        bits
    }

    fn ran_out(&self) -> bool {
        self.n_missing > self.n_bits
    }

    /// Fills the buffer to at least 32 bits.
    fn fill(&mut self) {
        if let Some(next) = self.jpeg.get(self.at..).and_then(<[u8]>::first_chunk::<4>)
            && !next.contains(&0xff)
        {
            self.buffer |= u64::from(u32::from_be_bytes(*next)) << (32 - self.n_bits);
            self.n_bits += 32;
            self.at += 4;
            return;
        }
        while self.n_bits <= 56 {
            let byte = self.next_byte().unwrap_or_else(|| {
                self.n_missing = self.n_missing.saturating_add(8);
                0
            });
            self.buffer |= u64::from(byte) << (56 - self.n_bits);
            self.n_bits += 8;
        }
    }

    /// The next byte of the data; `None` at a marker or at the end. The 0 after a byte of 255 is
    /// skipped.
    fn next_byte(&mut self) -> Option<u8> {
        let &byte = self.jpeg.get(self.at)?;
        if byte != 0xff {
            self.at += 1;
            return Some(byte);
        }
        if self.jpeg.get(self.at + 1) != Some(&0) {
            return None;
        }
        self.at += 2;
        Some(byte)
    }

    /// Position after the last code.
    fn end_of_codes(&self) -> usize {
        let n_buffered = self.n_bits.saturating_sub(self.n_missing) / 8;
        (0..n_buffered).fold(self.at, |at, _| {
            let is_pair = at >= 2 && self.jpeg[at - 2..at] == [0xff, 0];
            at - if is_pair { 2 } else { 1 }
        })
    }

    /// Continues after the restart marker with this number.
    fn restart(&mut self, number: u8, junk: &mut Vec<Range<usize>>) -> Result<(), ScanError> {
        let end = self.end_of_codes();
        let at = next_marker(self.jpeg, end);
        match self.jpeg.get(at + 1) {
            Some(&marker) if marker == 0xd0 + number => {}
            None => return Err(ScanError::Short),
            Some(_) => return Err(ScanError::Damaged("a restart marker is missing")),
        }
        if at > end {
            junk.push(end..at);
        }
        *self = Self::new(self.jpeg, at + 2);
        Ok(())
    }

    /// Position of the marker that ends the scan, or the end of the image.
    fn finish(self, junk: &mut Vec<Range<usize>>) -> usize {
        let end = self.end_of_codes();
        let mut at = next_marker(self.jpeg, end);
        // Some encoders also write a restart marker after the last unit.
        while let Some(0xd0..=0xd7) = self.jpeg.get(at + 1) {
            at = next_marker(self.jpeg, at + 2);
        }
        if at > end {
            junk.push(end..at);
        }
        at
    }
}

/// Position of the first marker, after its fill bytes, or the end of the image.
pub(super) fn next_marker(jpeg: &[u8], mut at: usize) -> usize {
    loop {
        let Some(rest) = jpeg.get(at..) else {
            return jpeg.len();
        };
        match rest.iter().position(|&byte| byte == 0xff) {
            Some(found) => at += found,
            None => return jpeg.len(),
        }
        match jpeg.get(at + 1) {
            Some(0x00) => at += 2,
            Some(0xff) => at += 1,
            Some(_) => return at,
            None => return jpeg.len(),
        }
    }
}
