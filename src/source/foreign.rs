//! MCAP files that overcam did not write: which of their messages are images, and in which order and at which moments.
//!
//! Such a file says little that can be relied on. It may have no summary, or a wrong one; messages may stand in any order; the time
//! at which a message was written is when it arrived, which network and buffers make jump. So the file is read twice. [`survey`]
//! reads it from its start to its end and notes the times of all images; then [`Order`] gives back each image in its turn while
//! the file is read for the second time.
//!
//! An image's moment is the timestamp in it, or when it was written where the images have none. Clocks are set while they run: where
//! the timestamps leave the times of writing by more than any delay, the clock stepped, and time goes on as those do.
//!
//! Deliberately absent: ROS messages, and images as JSON.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::io::Read;

use foxglove::bytes::Bytes;
use mcap::records::{Channel, Record};

use crate::output::foxglove::image_message::{ImageSchema, image_schema, time_of_message};
use crate::output::mcap::records::{Records, RecordsError};

/// A timestamp that is earlier than the one before by more than this, though it was written later, shows a clock that was set. Less
/// comes from messages that overtook each other.
const OVERTAKING_NS: i128 = 250_000_000;
/// The same in times between two images, for slow cameras.
const OVERTAKING_PERIODS: i128 = 4;
/// A timestamp that is further ahead of the one before than the time of writing, by more than this, shows a clock that was set.
const DELAY_NS: i128 = 10_000_000_000;

/// Most images that are looked at to tell a clock that was set back from another order.
const RUN_MAX: usize = 10_000;

/// What one reading of a file finds.
#[derive(Debug, Default)]
pub(crate) struct Survey {
    schemas: HashMap<u16, (String, String)>,
    pub(crate) channels: HashMap<u16, ForeignChannel>,
    /// The images in the order of the file.
    images: Vec<ImageTimes>,
}

/// A topic, and what its messages are.
#[derive(Debug)]
pub(crate) struct ForeignChannel {
    pub(crate) topic: String,
    /// Name of the message type.
    schema: String,
    /// How the messages are written.
    encoding: String,
    /// How they are read, if they are images that can be.
    pub(crate) image: Option<ImageSchema>,
    n_messages: u64,
}

#[derive(Debug, Clone, Copy)]
struct ImageTimes {
    written_ns: u64,
    /// The timestamp in the image: none, or what cannot be read.
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

/// Reads all records, up to the end or to where the file is cut or damaged; the second reading gets there again.
///
/// # Errors
///
/// What ended the reading, if no image was found before.
pub(crate) fn survey<R: Read>(mut records: Records<R>) -> Result<Survey, RecordsError> {
    let mut survey = Survey::default();
    let result = loop {
        match records.next() {
            Ok(Some(record)) => match record.parse() {
                // What follows is the summary.
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
        // A message is written as its channel says; many leave that to the schema.
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

    /// All channels, for people to read.
    pub(crate) fn topics(&self) -> String {
        let mut topics: Vec<String> = self.channels.values().map(ToString::to_string).collect();
        topics.sort_unstable();
        topics.dedup();
        if topics.is_empty() {
            return "none".to_owned();
        }
        topics.join(", ")
    }

    /// The topics that have images.
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

    /// The order of the images of a file with one image topic, and where its clocks were set.
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
        // 128 bits hold the sum of all that 64 can say in any file; of what a file says, 64 may.
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

    /// Whether the images carry moments: all do, and not all the same.
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

    /// The moments by the timestamps, in the order of the file, with every clock step taken out. `by_writing` orders the images by
    /// when they were written.
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
        // Timestamp, time of writing and moment of the newest image with a timestamp.
        let mut newest: Option<(i128, i128, i128)> = None;
        for &i in by_writing {
            let Some(stamp) = own(i) else {
                // An image that cannot be read has a turn, too.
                moments[i] = newest.map_or(written[i], |(_, before, moment)| {
                    moment + (written[i] - before)
                });
                continue;
            };
            if let Some((stamp_before, written_before, _)) = newest {
                let (elapsed, written_apart) = (stamp - stamp_before, written[i] - written_before);
                // The writer may have the clock of the camera.
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

/// A clock that was set while the file was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ClockStep {
    /// The first image after it, by its place in the file.
    pub(crate) image: usize,
    pub(crate) step_ns: i128,
}

/// The times of writing, with every step of the writer's clock backwards taken out.
///
/// Going backwards alone is no step: messages may stand in any order. But then they fill gaps; what is written after a clock was set
/// back lies among what was written before.
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
        // All that is earlier than what came before it.
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

/// Gives images, which come in the order of the file, in the order of their moments.
#[derive(Debug)]
pub(crate) struct Order {
    /// By place in the file.
    turns: Vec<usize>,
    /// By turn, counted from the first.
    stamps_ns: Vec<u64>,
    n_read: usize,
    /// Turn that is next.
    next: usize,
    /// By turn.
    waiting: BTreeMap<usize, (ImageSchema, Bytes)>,
    waiting_bytes: usize,
}

/// An image whose turn it is.
pub(crate) struct Due {
    /// Its number, from 0.
    pub(crate) number: u64,
    pub(crate) stamp_ns: u64,
    pub(crate) schema: ImageSchema,
    pub(crate) message: Bytes,
}

impl Order {
    /// Takes the next image of the file. One that was not there at the first reading is left out.
    pub(crate) fn add(&mut self, schema: ImageSchema, message: Bytes) {
        if let Some(&turn) = self.turns.get(self.n_read) {
            self.waiting_bytes += message.len();
            self.waiting.insert(turn, (schema, message));
            self.n_read += 1;
        }
    }

    /// The next image in time, if it has been read.
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

    /// Bytes of the images that wait for an earlier one.
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

    /// Places in the file and stamps in milliseconds, in order of time; and the steps in milliseconds.
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
            // The camera's clock alone.
            let times: Vec<_> = (0..20).map(|i| (5000 + 40 * i, Some(stepped(i)))).collect();
            assert_eq!(ordered(&times), (expected.clone(), vec![(10, step)]));
        }
        // The one clock of a machine that is both camera and writer. Forward, nothing tells it from a pause.
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
