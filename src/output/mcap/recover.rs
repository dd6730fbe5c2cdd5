//! Recovery: a complete, indexed file out of a recording whose writer was stopped, or whose content is damaged.
//!
//! Every chunk whose checksum holds is kept, with its messages, in their order; so are metadata and attachments, in their
//! place. A damaged chunk or attachment is left out and counted, an unfinished one at the end is left out. Reading goes on
//! behind damage as long as the lengths of the records still lead from one to the next.
//!
//! It works on any MCAP file, not only on those of overcam. An intact file is rewritten with an index.
//!
//! Deliberately absent: messages out of a chunk whose checksum fails. What is kept is what was written.

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

/// What was kept and what was not.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Report {
    /// Messages kept.
    pub messages: u64,
    /// Images among them.
    pub images: u64,
    /// Attachments kept.
    pub attachments: u64,
    /// Chunks, attachments and other records left out because they are damaged.
    pub damaged: u64,
    /// Whether the input was read up to its proper end.
    pub complete: bool,
    /// Time between the first and the last message kept, by their log times.
    pub duration_ns: u64,
    /// Size of the new file.
    pub bytes: u64,
}

/// Why nothing can be recovered.
#[derive(Debug, thiserror::Error)]
pub enum RecoverError {
    /// The input cannot be opened.
    #[error("{} {source}", path.display())]
    Open {
        /// The input.
        path: PathBuf,
        /// Why.
        source: OpenError,
    },
    /// The input is something else.
    #[error("{} is not an MCAP file: there is nothing to recover", path.display())]
    NotMcap {
        /// The input.
        path: PathBuf,
    },
    /// The system could not read the input on. The output holds what came before.
    #[error("{} cannot be read any further ({source}); {} holds what came before", path.display(), output.display())]
    Read {
        /// The input.
        path: PathBuf,
        /// The output.
        output: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The output cannot be written. It is removed again.
    #[error(transparent)]
    Output(#[from] RecordError),
}

/// Rewrites what is readable of `input` into the new file `output`.
///
/// # Errors
///
/// [`RecoverError`] when the input cannot be read or is no MCAP file, or when the output exists or cannot be written.
pub fn recover(input: &Path, output: &Path) -> Result<Report, RecoverError> {
    let file = open(input).map_err(|source| RecoverError::Open {
        path: input.to_owned(),
        source,
    })?;
    let mut records = Records::new(file, Chunks::Whole);
    // The first record is the header, of which nothing is kept: a file without it is not worth an output.
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
            // Half a copy is of no use; if it cannot be removed either, the error to tell is still the first.
            let _ = fs::remove_file(output);
            Err(write_error(output, 0, error).into())
        }
    }
}

/// The output, and the numbers that schemas and channels have in it.
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

    /// Copies every record up to the end of the data or of what is readable. Returns the error if the system could not read on.
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

    /// Copies a record of the file, a chunk record by record.
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
                    // Its channel was defined in a chunk that is lost.
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
            // The new file gets a header and an index of its own.
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
