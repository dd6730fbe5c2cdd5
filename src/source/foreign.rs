//! MCAP files of other programs: which messages are images, their order and their times.
//!
//! Little can be assumed about such a file. It may have no summary, or a wrong one; messages may be
//! in any order; the log time of a message is its arrival time, with jitter from network and
//! buffers. So the file is read twice. [`survey`] reads all of it and collects the times of all
//! images; then [`Order`] returns the images in order of time during the second pass.
//!
//! The time of an image is its own timestamp, or the log time if the images have none. Clocks may
//! be set during a recording: where the difference between timestamps and log times exceeds any
//! delay, the clock stepped, and the log times are used to bridge the step.
//!
//! Deliberately absent: ROS messages, and images as JSON.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::io::Read;

use foxglove::bytes::Bytes;
use mcap::records::{Channel, Record};

use crate::output::foxglove::image_message::{ImageSchema, image_schema, time_of_message};
use crate::output::mcap::records::{Records, RecordsError};

/// A timestamp that is earlier than the previous one by more than this, although logged later,
/// indicates a clock step. Smaller differences come from reordered messages.
const OVERTAKING_NS: i128 = 250_000_000;
/// The same in frame periods, for slow cameras.
const OVERTAKING_PERIODS: i128 = 4;
/// A timestamp that has advanced more than the log time, by more than this, indicates a clock step.
const DELAY_NS: i128 = 10_000_000_000;

/// Maximum number of images examined to distinguish a clock set back from reordering.
const RUN_MAX: usize = 10_000;

/// Result of the first pass over a file.
#[derive(Debug, Default)]
pub(crate) struct Survey {
    schemas: HashMap<u16, (String, String)>,
    pub(crate) channels: HashMap<u16, ForeignChannel>,
    /// The images in file order.
    images: Vec<ImageTimes>,
}

/// A topic and its message type.
#[derive(Debug)]
pub(crate) struct ForeignChannel {
    pub(crate) topic: String,
    /// Name of the message type.
    schema: String,
    /// Encoding of the messages.
    encoding: String,
    /// Image type, if the messages are images in a supported encoding.
    pub(crate) image: Option<ImageSchema>,
    n_messages: u64,
}

#[derive(Debug, Clone, Copy)]
struct ImageTimes {
    written_ns: u64,
    /// The timestamp in the image; `None` if absent or unreadable.
    own: Option<u64>,
    is_readable: bool,
}

impl std::fmt::Display for ForeignChannel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let or_none = |text: &str| match text {
            "" => "none".to_owned(),
            text => text.to_owned(),
        };
        let (schema, encoding) = (or_none(&self.schema), or_none(&self.encoding));
        write!(f, "{} ({schema}, {encoding})", self.topic)
    }
}

/// Reads all records, up to the end or to where the file is truncated or damaged; the second pass
/// ends at the same place.
///
/// # Errors
///
/// The error that ended the pass, if no image was found before.
pub(crate) fn survey<R: Read>(mut records: Records<R>) -> Result<Survey, RecordsError> {
    let mut survey = Survey::default();
    let result = loop {
        match records.next() {
            Ok(Some(record)) => match record.parse() {
                // The summary follows.
                Ok(Record::DataEnd(_)) => break Ok(()),
                Ok(Record::Schema { header, .. }) => {
                    survey
                        .schemas
                        .insert(header.id, (header.name, header.encoding));
                }
                Ok(Record::Channel(channel)) => survey.add_channel(channel),
                Ok(Record::Message { header, data }) => {
                    let message = record.content.slice_ref(&data);
                    survey.add_message(header.channel_id, header.log_time, message);
                }
                Ok(_) => {}
                Err(error) => break Err(error),
            },
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    match result {
        Err(error) if survey.images.is_empty() => Err(error),
        _ => Ok(survey),
    }
}

impl Survey {
    fn add_channel(&mut self, channel: Channel) {
        let (schema, schema_encoding) = self
            .schemas
            .get(&channel.schema_id)
            .cloned()
            .unwrap_or_default();
        // The channel gives the encoding of messages; many leave it to the schema.
        let encoding = match channel.message_encoding.as_str() {
            "" => schema_encoding.clone(),
            stated => stated.to_owned(),
        };
        let image = image_schema(&schema, &schema_encoding).filter(|_| encoding == "protobuf");
        self.channels.entry(channel.id).or_insert(ForeignChannel {
            topic: channel.topic,
            schema,
            encoding,
            image,
            n_messages: 0,
        });
    }

    fn add_message(&mut self, channel_id: u16, written_ns: u64, message: Bytes) {
        let Some(channel) = self.channels.get_mut(&channel_id) else {
            return;
        };
        channel.n_messages += 1;
        let Some(schema) = channel.image else { return };
        let own = time_of_message(schema, message);
        self.images.push(ImageTimes {
            written_ns,
            own: own.as_ref().ok().copied().flatten(),
            is_readable: own.is_ok(),
        });
    }

    /// All channels, as text.
    pub(crate) fn topics(&self) -> String {
        let mut topics: Vec<String> = self.channels.values().map(ToString::to_string).collect();
        topics.sort_unstable();
        topics.dedup();
        if topics.is_empty() {
            return "none".to_owned();
        }
        topics.join(", ")
    }

    /// The topics with images.
    pub(crate) fn image_topics(&self) -> Vec<&str> {
        let with_images = self
            .channels
            .values()
            .filter(|channel| channel.image.is_some() && channel.n_messages > 0);
        let mut topics: Vec<&str> = with_images.map(|channel| channel.topic.as_str()).collect();
        topics.sort_unstable();
        topics.dedup();
        topics
    }

    /// The order of the images of a file with one image topic, and its clock steps.
    pub(crate) fn order(&self) -> (Order, Vec<ClockStep>) {
        let (written, mut steps) = straightened(&self.images);
        let mut by_writing: Vec<usize> = (0..written.len()).collect();
        by_writing.sort_by_key(|&i| written[i]);
        let moments = if self.has_timestamps() {
            self.moments(&written, &by_writing, &mut steps)
        } else {
            written.clone()
        };
        let mut order = by_writing;
        order.sort_by_key(|&i| moments[i]);
        let mut turns = vec![0; order.len()];
        for (turn, &i) in order.iter().enumerate() {
            turns[i] = turn;
        }
        let first = order.first().map_or(0, |&i| moments[i]);
        // 128 bits hold any sum of 64-bit values in a file; the result must fit 64 bits.
        let stamp_ns = |&i: &usize| u64::try_from(moments[i] - first).unwrap_or(u64::MAX);
        let stamps_ns = order.iter().map(stamp_ns).collect();
        let order = Order {
            turns,
            stamps_ns,
            n_read: 0,
            next: 0,
            waiting: BTreeMap::new(),
            waiting_bytes: 0,
        };
        (order, steps)
    }

    /// Whether the images have timestamps: all of them, and not all equal.
    fn has_timestamps(&self) -> bool {
        let mut own = self
            .images
            .iter()
            .filter(|image| image.is_readable)
            .map(|image| image.own);
        let first = own.clone().next().flatten();
        let all_alike = self.images.len() > 1 && own.clone().all(|own| own == first);
        !all_alike && own.all(|own| own.is_some_and(|own| own > 0))
    }

    /// Times from the timestamps, in file order, with all clock steps removed. `by_writing` is the
    /// order of the images by log time.
    fn moments(
        &self,
        written: &[i128],
        by_writing: &[usize],
        steps: &mut Vec<ClockStep>,
    ) -> Vec<i128> {
        let own = |i: usize| self.images[i].own.map(i128::from);
        let pairs = by_writing
            .windows(2)
            .filter_map(|pair| Some(own(pair[1])? - own(pair[0])?));
        let period = median(pairs.filter(|&elapsed| elapsed > 0).collect());
        let overtaking = OVERTAKING_NS.max(OVERTAKING_PERIODS.saturating_mul(period));
        let of_writer: HashSet<usize> = steps.iter().map(|step| step.image).collect();
        let mut moments = written.to_vec();
        let mut offset = 0;
        // Timestamp, log time and resulting time of the newest image with a timestamp.
        let mut newest: Option<(i128, i128, i128)> = None;
        for &i in by_writing {
            let Some(stamp) = own(i) else {
                // An image that cannot be decoded also needs a time.
                moments[i] = newest.map_or(written[i], |(_, before, moment)| {
                    moment + (written[i] - before)
                });
                continue;
            };
            if let Some((stamp_before, written_before, _)) = newest {
                let (elapsed, written_apart) = (stamp - stamp_before, written[i] - written_before);
                // Writer and camera may share a clock.
                let is_known = of_writer.contains(&i);
                if elapsed < -overtaking
                    || elapsed > written_apart + DELAY_NS
                    || (is_known && elapsed < 0)
                {
                    let plausible = if written_apart > 0 {
                        written_apart
                    } else {
                        period
                    };
                    let step_ns = elapsed - plausible;
                    offset -= step_ns;
                    if !is_known {
                        steps.push(ClockStep { image: i, step_ns });
                    }
                }
            }
            moments[i] = stamp + offset;
            newest = Some((stamp, written[i], moments[i]));
        }
        moments
    }
}

/// A clock step during the recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ClockStep {
    /// The first image after it, by position in the file.
    pub(crate) image: usize,
    pub(crate) step_ns: i128,
}

/// The log times, with all backward steps of the writer's clock removed.
///
/// A decrease alone is not a step: messages may be in any order. But reordered messages fill gaps,
/// while those logged after a clock was set back lie between those logged before.
fn straightened(images: &[ImageTimes]) -> (Vec<i128>, Vec<ClockStep>) {
    let raw: Vec<i128> = images
        .iter()
        .map(|image| i128::from(image.written_ns))
        .collect();
    let period = median(
        raw.windows(2)
            .map(|pair| pair[1] - pair[0])
            .filter(|&e| e > 0)
            .collect(),
    );
    let (mut written, mut steps) = (raw.clone(), Vec::new());
    let mut offset = 0;
    // The latest so far, without offset.
    let Some(mut latest) = raw.first().copied() else {
        return (written, steps);
    };
    let mut i = 1;
    while i < raw.len() {
        if raw[i] >= latest {
            latest = raw[i];
            written[i] = raw[i] + offset;
            i += 1;
            continue;
        }
        // All that are earlier than what precedes them.
        let n_earlier = raw[i..]
            .iter()
            .take(RUN_MAX)
            .take_while(|&&time| time < latest)
            .count();
        let run = &raw[i..i + n_earlier];
        let range = run.iter().min().zip(run.iter().max());
        let before = &raw[i.saturating_sub(2 * n_earlier + 2)..i];
        let n_among = range.map_or(0, |(min, max)| {
            before
                .iter()
                .filter(|time| (min..=max).contains(time))
                .count()
        });
        let is_step = n_earlier > 2 && 2 * n_among >= n_earlier;
        if is_step {
            let step_ns = raw[i] - (latest + period);
            steps.push(ClockStep { image: i, step_ns });
            offset -= step_ns;
            latest = raw[i];
            written[i] = raw[i] + offset;
            i += 1;
        } else {
            for k in i..i + n_earlier {
                written[k] = raw[k] + offset;
            }
            i += n_earlier;
        }
    }
    (written, steps)
}

fn median(mut values: Vec<i128>) -> i128 {
    if values.is_empty() {
        return 0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable(middle).1
}

/// Reorders images from file order to time order.
#[derive(Debug)]
pub(crate) struct Order {
    /// Indexed by position in the file.
    turns: Vec<usize>,
    /// Indexed by turn, counted from the first.
    stamps_ns: Vec<u64>,
    n_read: usize,
    /// The next turn.
    next: usize,
    /// Keyed by turn.
    waiting: BTreeMap<usize, (ImageSchema, Bytes)>,
    waiting_bytes: usize,
}

/// An image whose turn has come.
pub(crate) struct Due {
    /// Its sequence number, from 0.
    pub(crate) number: u64,
    pub(crate) stamp_ns: u64,
    pub(crate) schema: ImageSchema,
    pub(crate) message: Bytes,
}

impl Order {
    /// Adds the next image of the file. Images that were not found in the first pass are dropped.
    pub(crate) fn add(&mut self, schema: ImageSchema, message: Bytes) {
        if let Some(&turn) = self.turns.get(self.n_read) {
            self.waiting_bytes += message.len();
            self.waiting.insert(turn, (schema, message));
            self.n_read += 1;
        }
    }

    /// The next image in time order, if it has been read.
    pub(crate) fn due(&mut self) -> Option<Due> {
        let (schema, message) = self.waiting.remove(&self.next)?;
        let turn = self.next;
        self.next += 1;
        self.waiting_bytes -= message.len();
        Some(Due {
            number: turn as u64,
            stamp_ns: self.stamps_ns[turn],
            schema,
            message,
        })
    }

    /// Number of bytes of images waiting for an earlier one.
    pub(crate) fn waiting_bytes(&self) -> usize {
        self.waiting_bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn survey_of(times: &[(u64, Option<u64>)]) -> Survey {
        let image = |&(written_ms, own_ms): &(u64, Option<u64>)| ImageTimes {
            written_ns: written_ms * MS,
            own: own_ms.map(|ms| ms * MS),
            is_readable: true,
        };
        Survey {
            images: times.iter().map(image).collect(),
            ..Survey::default()
        }
    }

    /// Positions in the file and stamps in milliseconds, in time order; and the steps in
    /// milliseconds.
    type Ordered = (Vec<(usize, u64)>, Vec<(usize, i64)>);

    fn ordered(times: &[(u64, Option<u64>)]) -> Ordered {
        let (order, steps) = survey_of(times).order();
        let mut places: Vec<(usize, u64)> = order
            .turns
            .iter()
            .enumerate()
            .map(|(place, &turn)| (place, order.stamps_ns[turn] / MS))
            .collect();
        places.sort_by_key(|&(place, _)| order.turns[place]);
        let steps = steps
            .iter()
            .map(|s| (s.image, (s.step_ns / i128::from(MS)) as i64))
            .collect();
        (places, steps)
    }

    #[test]
    fn images_are_at_their_own_timestamps() {
        // Written in bursts of five.
        let times: Vec<_> = (0..20)
            .map(|i| (5000 + i / 5 * 200, Some(1000 + 40 * i)))
            .collect();
        let (places, steps) = ordered(&times);
        let expected: Vec<_> = (0..20).map(|i| (i as usize, 40 * i)).collect();
        assert_eq!((places, steps), (expected, vec![]));
    }

    #[test]
    fn without_timestamps_they_are_when_they_were_written() {
        for own in [None, Some(0), Some(77)] {
            let times: Vec<_> = (0..5).map(|i| (5000 + 40 * i, own)).collect();
            let expected: Vec<_> = (0..5).map(|i| (i as usize, 40 * i)).collect();
            assert_eq!(ordered(&times), (expected, vec![]));
        }
    }

    #[test]
    fn any_order_in_the_file_becomes_that_of_time() {
        let exchanged = [0, 1, 3, 2, 4, 5, 9, 8, 7, 6, 10];
        let halves = [5, 6, 7, 8, 9, 0, 1, 2, 3, 4];
        for places in [&exchanged[..], &halves] {
            for own in [true, false] {
                let times: Vec<_> = places
                    .iter()
                    .map(|&i| (5000 + 40 * i, own.then_some(9000 + 40 * i)))
                    .collect();
                let (found, steps) = ordered(&times);
                assert_eq!(steps, []);
                let times: Vec<_> = found
                    .iter()
                    .map(|&(place, stamp)| (places[place], stamp))
                    .collect();
                let expected: Vec<_> = (0..places.len() as u64).map(|i| (i, 40 * i)).collect();
                assert_eq!(times, expected);
            }
        }
    }

    #[test]
    fn time_goes_on_where_a_clock_was_set() {
        let expected: Vec<_> = (0..20).map(|i| (i as usize, 40 * i)).collect();
        for step in [-3_600_000, -1_000, 3_600_000] {
            let stepped =
                |i: u64| (10_000_000 + 40 * i as i64 + if i < 10 { 0 } else { step }) as u64;
            // Only the camera's clock.
            let times: Vec<_> = (0..20).map(|i| (5000 + 40 * i, Some(stepped(i)))).collect();
            assert_eq!(ordered(&times), (expected.clone(), vec![(10, step)]));
        }
        // A single clock for camera and writer. A forward step cannot be distinguished from a
        // pause.
        let stepped = |i: u64| 10_000_000 + 40 * i - if i < 10 { 0 } else { 240 };
        let times: Vec<_> = (0..20).map(|i| (stepped(i), Some(stepped(i)))).collect();
        let (places, steps) = ordered(&times);
        assert_eq!(places, expected);
        assert!(steps.contains(&(10, -240)), "{steps:?}");
        let times: Vec<_> = (0..20).map(|i| (stepped(i), None)).collect();
        assert_eq!(ordered(&times), (expected, vec![(10, -240)]));
    }

    #[test]
    fn pauses_and_overtaking_are_no_steps() {
        let pause = |i: u64| 40 * i + if i < 5 { 0 } else { 60_000 };
        let times: Vec<_> = (0..10)
            .map(|i| (1 + pause(i), Some(1 + pause(i))))
            .collect();
        let expected: Vec<_> = (0..10).map(|i| (i as usize, pause(i))).collect();
        assert_eq!(ordered(&times), (expected, vec![]));
        let own = [0, 1, 3, 2, 4, 5];
        let times: Vec<_> = (0..6)
            .map(|i| (1 + 40 * i, Some(1 + 40 * own[i as usize])))
            .collect();
        let (places, steps) = ordered(&times);
        assert_eq!(
            places.iter().map(|p| p.0).collect::<Vec<_>>(),
            [0, 1, 3, 2, 4, 5]
        );
        assert_eq!(steps, []);
    }

    #[test]
    fn images_come_in_their_turn() {
        let (mut order, _) = survey_of(&[(2, None), (3, None), (1, None)]).order();
        let message = |byte: u8| Bytes::copy_from_slice(&[byte; 10]);
        order.add(ImageSchema::Raw, message(2));
        order.add(ImageSchema::Raw, message(3));
        assert!(order.due().is_none());
        assert_eq!(order.waiting_bytes(), 20);
        order.add(ImageSchema::Raw, message(1));
        order.add(ImageSchema::Raw, message(9));
        let due: Vec<_> = std::iter::from_fn(|| order.due()).collect();
        let found: Vec<_> = due
            .iter()
            .map(|due| (due.number, due.stamp_ns, due.message[0]))
            .collect();
        assert_eq!(found, [(0, 0, 1), (1, MS, 2), (2, 2 * MS, 3)]);
        assert_eq!(order.waiting_bytes(), 0);
    }
}
