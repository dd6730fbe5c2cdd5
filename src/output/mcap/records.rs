//! Reads the records of an MCAP file sequentially, in bounded memory.
//!
//! A thin layer over the `mcap` crate's sans-io reader, which is fed from any [`Read`]. It adds
//! what damaged files require: a limit for the length of a record, reads in small portions so that
//! a corrupt length does not allocate memory for data that do not exist, and a check of the
//! lengths of texts and attachments, which the crate trusts.
//!
//! Deliberately absent: seeking. A recording is read sequentially, so no index is needed.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use foxglove::bytes::Bytes;
use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

/// Maximum size of a record, and of a chunk before and after compression. A frame of 8192x8192 in
/// RGB fits.
const RECORD_BYTES_MAX: usize = 256 << 20;
/// Maximum number of bytes per read.
const PORTION_BYTES: usize = 1 << 20;

/// Whether chunks are unpacked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Chunks {
    /// The records inside are returned. The checksum of a chunk is verified before its first
    /// record.
    Unpacked,
    /// A chunk is returned as one record. See [`unpack_chunk`].
    Whole,
}

/// Reader of records.
pub(crate) struct Records<R> {
    source: R,
    reader: LinearReader,
    /// The part of the file's magic bytes that has not been read yet.
    magic: &'static [u8],
}

/// One record: its type and its content.
pub(crate) struct RawRecord {
    pub(crate) opcode: u8,
    pub(crate) content: Bytes,
}

/// Reasons why there is no next record.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RecordsError {
    /// A read error of the system.
    #[error(transparent)]
    File(io::Error),
    /// The file does not start with MCAP magic bytes.
    #[error("not an MCAP file")]
    NotMcap,
    /// The file ends before its end mark.
    #[error("ends in the middle")]
    Truncated,
    /// The content is invalid.
    #[error(transparent)]
    Damaged(McapError),
}

/// Reasons why a path cannot be opened as an MCAP file.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// An error of the system.
    #[error("cannot be opened ({0}); check its name")]
    System(#[from] io::Error),
    /// The path is a folder.
    #[error("is a folder, not a recording; name the .mcap file in it")]
    Folder,
    /// The file is empty.
    #[error("is empty: nothing was recorded")]
    Empty,
}

/// Opens a file for reading.
pub(crate) fn open(path: &Path) -> Result<File, OpenError> {
    let file = File::open(path)?;
    let metadata = file.metadata()?;
    if metadata.is_dir() {
        Err(OpenError::Folder)
    } else if metadata.is_file() && metadata.len() == 0 {
        Err(OpenError::Empty)
    } else {
        Ok(file)
    }
}

impl<R: Read> Records<R> {
    /// A reader for a whole MCAP file.
    pub(crate) fn new(source: R, chunks: Chunks) -> Self {
        let mut records = Self::with_options(source, LinearReaderOptions::default(), chunks);
        records.magic = mcap::MAGIC;
        records
    }

    fn with_options(source: R, options: LinearReaderOptions, chunks: Chunks) -> Self {
        let options = options
            .with_emit_chunks(chunks == Chunks::Whole)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(RECORD_BYTES_MAX);
        Self {
            source,
            reader: LinearReader::new_with_options(options),
            magic: &[],
        }
    }

    /// The next record; `None` after the end mark.
    pub(crate) fn next(&mut self) -> Result<Option<RawRecord>, RecordsError> {
        while let Some(event) = self.reader.next_event() {
            match event {
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    return Ok(Some(RawRecord {
                        opcode,
                        content: Bytes::copy_from_slice(data),
                    }));
                }
                Ok(LinearReadEvent::ReadRequest(n_bytes)) => {
                    let buffer = self.reader.insert(n_bytes.min(PORTION_BYTES));
                    let n_read = read(&mut self.source, buffer).map_err(RecordsError::File)?;
                    // The crate's reader checks the magic bytes as a whole, and would treat a
                    // shorter file as a truncated recording.
                    let n_magic = n_read.min(self.magic.len());
                    let (due, rest) = self.magic.split_at(n_magic);
                    if buffer[..n_magic] != *due {
                        return Err(RecordsError::NotMcap);
                    }
                    self.magic = rest;
                    self.reader.notify_read(n_read);
                }
                Err(McapError::UnexpectedEof) => return Err(RecordsError::Truncated),
                Err(McapError::BadMagic) => return Err(RecordsError::NotMcap),
                Err(error) => return Err(RecordsError::Damaged(error)),
            }
        }
        Ok(None)
    }
}

impl RawRecord {
    /// The record's fields.
    pub(crate) fn parse(&self) -> Result<Record<'_>, RecordsError> {
        // It says where chunks are; nobody here goes there.
        if self.opcode == op::CHUNK_INDEX {
            return Ok(Record::Unknown {
                opcode: self.opcode,
                data: Cow::Borrowed(&self.content),
            });
        }
        let is_whole = has_its_texts(self.opcode, &self.content)
            && (self.opcode != op::ATTACHMENT || is_attachment(&self.content));
        if !is_whole {
            return Err(RecordsError::Damaged(McapError::UnexpectedEof));
        }
        mcap::parse_record(self.opcode, &self.content).map_err(RecordsError::Damaged)
    }
}

/// The records in a chunk record, after verification of its checksum.
pub(crate) fn unpack_chunk(content: &[u8]) -> Result<Vec<RawRecord>, RecordsError> {
    let framing = [&[op::CHUNK][..], &(content.len() as u64).to_le_bytes()].concat();
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true);
    let mut records = Records::with_options(framing.chain(content), options, Chunks::Unpacked);
    let mut unpacked = Vec::new();
    while let Some(record) = records.next()? {
        unpacked.push(record);
    }
    Ok(unpacked)
}

fn read(source: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        match source.read(buffer) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            result => return result,
        }
    }
}

/// What follows a text and its length.
fn skip_text(content: &[u8]) -> Option<&[u8]> {
    let (length, rest) = content.split_first_chunk()?;
    rest.get(u32::from_le_bytes(*length) as usize..)
}

/// What follows keys and values and their length in bytes.
fn skip_map(content: &[u8]) -> Option<&[u8]> {
    let (length, mut rest) = content.split_first_chunk()?;
    let end = rest
        .len()
        .checked_sub(u32::from_le_bytes(*length) as usize)?;
    while rest.len() > end {
        rest = skip_text(skip_text(rest)?)?;
    }
    Some(rest)
}

/// Whether the texts of a record are in it. The crate takes memory for as much as a text claims,
/// which may be 4 GiB.
fn has_its_texts(opcode: u8, content: &[u8]) -> bool {
    let (n_before, n_texts, has_map) = match opcode {
        op::HEADER => (0, 2, false),
        op::SCHEMA => (2, 2, false),
        op::CHANNEL => (4, 2, true),
        op::CHUNK => (28, 1, false),
        op::ATTACHMENT => (16, 2, false),
        op::ATTACHMENT_INDEX => (40, 2, false),
        op::METADATA => (0, 1, true),
        op::METADATA_INDEX => (16, 1, false),
        _ => return true,
    };
    let texts = content.get(n_before..);
    let rest = (0..n_texts).fold(texts, |rest, _| rest.and_then(skip_text));
    match has_map {
        true => rest.and_then(skip_map).is_some(),
        false => rest.is_some(),
    }
}

/// Whether the lengths in an attachment record are consistent: two times, name, media type, data,
/// checksum.
fn is_attachment(content: &[u8]) -> bool {
    content
        .get(16..)
        .and_then(skip_text)
        .and_then(skip_text)
        .and_then(<[u8]>::split_first_chunk)
        .is_some_and(|(length, rest)| {
            usize::try_from(u64::from_le_bytes(*length)).ok() == rest.len().checked_sub(4)
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_an_attachment_must_fit() {
        let mut good = vec![0; 16];
        for text in ["name", "text/plain"] {
            good.extend((text.len() as u32).to_le_bytes());
            good.extend(text.as_bytes());
        }
        good.extend(3_u64.to_le_bytes());
        good.extend([1, 2, 3, 0, 0, 0, 0]);
        assert!(is_attachment(&good));
        for length in 0..good.len() {
            assert!(!is_attachment(&good[..length]), "{length} bytes");
        }
        let mut endless_name = good.clone();
        endless_name[16..20].fill(0xff);
        assert!(!is_attachment(&endless_name));
        let mut endless_data = good;
        let length_at = endless_data.len() - 15;
        endless_data[length_at..length_at + 8].fill(0xff);
        assert!(!is_attachment(&endless_data));
    }

    #[test]
    fn lengths_of_texts_must_fit() {
        // A channel: two numbers, topic, encoding, and a key with its value.
        let text = |text: &str| [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
        let map = [text("key"), text("value")].concat();
        let length = (map.len() as u32).to_le_bytes().to_vec();
        let good = [vec![0; 4], text("/image"), text("json"), length, map].concat();
        assert!(has_its_texts(op::CHANNEL, &good));
        for length in 0..good.len() {
            assert!(
                !has_its_texts(op::CHANNEL, &good[..length]),
                "{length} bytes"
            );
        }
        for length_at in [4, 14, 22, 26, 33] {
            let mut endless = good.clone();
            endless[length_at + 3] = 0x7f;
            assert!(!has_its_texts(op::CHANNEL, &endless), "{length_at}");
        }
    }

    #[test]
    fn a_non_mcap_file_is_distinguished_from_a_truncated_one() {
        let first = |content: &[u8]| Records::new(content, Chunks::Unpacked).next().err();
        assert!(matches!(
            first(b"RIFF....AVI "),
            Some(RecordsError::NotMcap)
        ));
        assert!(matches!(first(b"hello"), Some(RecordsError::NotMcap)));
        assert!(matches!(
            first(&mcap::MAGIC[..5]),
            Some(RecordsError::Truncated)
        ));
        assert!(matches!(first(mcap::MAGIC), Some(RecordsError::Truncated)));
    }
}
