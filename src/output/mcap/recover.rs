//! Recovery: makes a complete, indexed file from a recording that is truncated or damaged.
//!
//! Every chunk with a valid checksum is kept, with its messages in their order; so are metadata and
//! attachments, in their position. A damaged chunk or attachment is dropped and counted; an
//! incomplete one at the end is dropped. Reading continues after damage as long as the lengths of
//! the records are consistent.
//!
//! Works for any MCAP file, not only for those of overcam. An intact file is rewritten with an
//! index.
//!
//! Deliberately absent: messages from a chunk with an invalid checksum. Only data known to be
//! correct are kept.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use mcap::records::{Record, op};
use mcap::{Attachment, McapResult};

use crate::output::foxglove::image_message::image_schema;
use crate::output::mcap::Mcap;
use crate::output::mcap::record::{CHUNK_BYTES, RecordError, create_file, open_mcap, write_error};
use crate::output::mcap::records::{
    Chunks, OpenError, RawRecord, Records, RecordsError, open, unpack_chunk,
};

/// Result of a recovery.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Report {
    /// Messages kept.
    pub messages: u64,
    /// Images among them.
    pub images: u64,
    /// Attachments kept.
    pub attachments: u64,
    /// Number of damaged chunks, attachments and other records that were dropped.
    pub damaged: u64,
    /// Whether the input was read up to its regular end.
    pub complete: bool,
    /// Time between the first and the last message kept, according to their log times.
    pub duration_ns: u64,
    /// Size of the new file.
    pub bytes: u64,
}

/// Reasons why nothing can be recovered.
#[derive(Debug, thiserror::Error)]
pub enum RecoverError {
    /// The input cannot be opened.
    #[error("{} {source}", path.display())]
    Open {
        /// The input.
        path: PathBuf,
        /// The cause.
        source: OpenError,
    },
    /// The input is not an MCAP file.
    #[error("{} is not an MCAP file: there is nothing to recover", path.display())]
    NotMcap {
        /// The input.
        path: PathBuf,
    },
    /// A read error of the system. The output has everything before it.
    #[error("{} cannot be read any further ({source}); {} holds what came before", path.display(), output.display())]
    Read {
        /// The input.
        path: PathBuf,
        /// The output.
        output: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The output cannot be written, and is removed again.
    #[error(transparent)]
    Output(#[from] RecordError),
}

/// Rewrites the readable part of `input` to the new file `output`.
///
/// # Errors
///
/// [`RecoverError`] if the input cannot be read or is not an MCAP file, or if the output exists or
/// cannot be written.
pub fn recover(input: &Path, output: &Path) -> Result<Report, RecoverError> {
    let file = open(input).map_err(|source| RecoverError::Open {
        path: input.to_owned(),
        source,
    })?;
    let mut records = Records::new(file, Chunks::Whole);
    // The first record is the header, of which nothing is kept: without one, no output is created.
    if matches!(records.next(), Err(RecordsError::NotMcap)) {
        return Err(RecoverError::NotMcap {
            path: input.to_owned(),
        });
    }
    let output_file = create_file(output)?;
    let copied = open_mcap(output_file).and_then(|mcap| {
        let mut target = Target::new(mcap);
        let unread = target.copy_all(&mut records)?;
        target.mcap.finish()?;
        Ok((target, unread))
    });
    match copied {
        Ok((_, Some(source))) => Err(RecoverError::Read {
            path: input.to_owned(),
            output: output.to_owned(),
            source,
        }),
        Ok((target, None)) => Ok(target.into_report(output)),
        Err(error) => {
            // A partial copy is useless. If it cannot be removed either, the first error is still
            // returned.
            let _ = fs::remove_file(output);
            Err(write_error(output, 0, error).into())
        }
    }
}

/// The output, and the mapping of schema and channel ids to it.
struct Target {
    mcap: Mcap,
    report: Report,
    schemas: HashMap<u16, CopiedSchema>,
    channels: HashMap<u16, CopiedChannel>,
    log_times_ns: Option<(u64, u64)>,
    chunk_bytes: usize,
}

struct CopiedSchema {
    id: u16,
    is_image: bool,
}

struct CopiedChannel {
    id: u16,
    is_image: bool,
}

impl Target {
    fn new(mcap: Mcap) -> Self {
        Self {
            mcap,
            report: Report::default(),
            schemas: HashMap::new(),
            channels: HashMap::new(),
            log_times_ns: None,
            chunk_bytes: 0,
        }
    }

    /// Copies every record up to the end of the data or of the readable part. Returns the error if
    /// the system could not read further.
    fn copy_all(&mut self, records: &mut Records<File>) -> McapResult<Option<io::Error>> {
        loop {
            match records.next() {
                Ok(Some(record)) if record.opcode == op::DATA_END => {
                    self.report.complete = true;
                    return Ok(None);
                }
                Ok(Some(record)) => self.copy(&record)?,
                Ok(None) | Err(RecordsError::Truncated | RecordsError::NotMcap) => return Ok(None),
                Err(RecordsError::Damaged(_)) => {
                    self.report.damaged += 1;
                    return Ok(None);
                }
                Err(RecordsError::File(error)) => return Ok(Some(error)),
            }
        }
    }

    /// Copies a record of the file; a chunk is copied record by record.
    fn copy(&mut self, record: &RawRecord) -> McapResult<()> {
        if record.opcode != op::CHUNK {
            return self.copy_unpacked(record);
        }
        let Ok(records) = unpack_chunk(&record.content) else {
            self.report.damaged += 1;
            return Ok(());
        };
        for record in &records {
            self.copy_unpacked(record)?;
        }
        Ok(())
    }

    fn copy_unpacked(&mut self, record: &RawRecord) -> McapResult<()> {
        let Ok(parsed) = record.parse() else {
            self.report.damaged += 1;
            return Ok(());
        };
        match parsed {
            Record::Metadata(metadata) => self.mcap.write_metadata(&metadata)?,
            Record::Attachment { header, data, .. } => {
                self.report.attachments += 1;
                self.mcap.attach(&Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name,
                    media_type: header.media_type,
                    data,
                })?;
            }
            Record::Schema { header, data } => {
                let id = self
                    .mcap
                    .add_schema(&header.name, &header.encoding, &data)?;
                let is_image = image_schema(&header.name, &header.encoding).is_some();
                self.schemas
                    .insert(header.id, CopiedSchema { id, is_image });
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id);
                let id = self.mcap.add_channel(
                    schema.map_or(0, |schema| schema.id),
                    &channel.topic,
                    &channel.message_encoding,
                    &channel.metadata,
                )?;
                let is_image = schema.is_some_and(|schema| schema.is_image);
                self.channels
                    .insert(channel.id, CopiedChannel { id, is_image });
            }
            Record::Message { mut header, data } => {
                let Some(channel) = self.channels.get(&header.channel_id) else {
                    // Its channel was defined in a lost chunk.
                    self.report.damaged += 1;
                    return Ok(());
                };
                header.channel_id = channel.id;
                self.mcap.write_to_known_channel(&header, &data)?;
                self.report.messages += 1;
                self.report.images += u64::from(channel.is_image);
                let (first, last) = self.log_times_ns.get_or_insert((u64::MAX, 0));
                *first = header.log_time.min(*first);
                *last = header.log_time.max(*last);
                self.chunk_bytes += data.len();
                if self.chunk_bytes >= CHUNK_BYTES {
                    self.mcap.flush()?;
                    self.chunk_bytes = 0;
                }
            }
            // The new file has its own header and index.
            _ => {}
        }
        Ok(())
    }

    fn into_report(self, output: &Path) -> Report {
        Report {
            duration_ns: self.log_times_ns.map_or(0, |(first, last)| last - first),
            bytes: fs::metadata(output).map_or(0, |metadata| metadata.len()),
            ..self.report
        }
    }
}
