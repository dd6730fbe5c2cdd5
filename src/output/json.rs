//! A scene as one line of JSON, for human readers, pipes and scripts.
//!
//! The keys are those of the README and never change their meaning; new ones may be added.
//! `heading` is omitted if an object has none, `marker` for an obstacle, `confidence` if no marker
//! was read in this frame, `overflow` if the scene is complete, `frame_age` (seconds) while frames
//! arrive. The covariance is that of (x, y, heading) for an object with a heading, otherwise that
//! of (x, y).
//!
//! Numbers are rounded to a resolution finer than the accuracy of any camera, so that lines are
//! short and equal scenes give equal bytes: lengths, velocities and sizes to 1e-4 px or 1e-6 m,
//! angles to 1e-6 rad, times to 1e-6 s, confidences to 1e-4, covariances to six significant digits.
//! There is no negative zero. JSON has no numbers that are not finite: such a value, which no stage
//! should produce, is written as `null`.
//!
//! Deliberately absent: [`Scene::published_ns`], which differs from run to run. So the same
//! recording gives the same lines from the program itself and from shared memory.

use std::io;

use scene::{
    FRAME_FLOOR, ForecastPoint, KIND_MARKER, LIGHT_CHANGED, LIGHT_DARK, Object, SOURCE_WAITING,
    Scene,
};
use serde::Serialize;
use serde::ser::{SerializeMap, SerializeSeq, Serializer};

/// Steps of an angle per radian.
const PER_RADIAN: f64 = 1e6;
/// Steps of a time per second.
const PER_SECOND: f64 = 1e6;
/// Steps of a share.
const PER_ONE: f64 = 1e4;

/// Writes `scene` and a line feed to `out`, in many small pieces, so `out` should be buffered.
///
/// # Errors
///
/// Any error of `out`; a `Vec` never fails.
pub fn write_line(scene: &Scene, out: &mut impl io::Write) -> io::Result<()> {
    serde_json::to_writer(&mut *out, &SceneJson(scene))?;
    out.write_all(b"\n")
}

struct SceneJson<'a>(&'a Scene);

impl Serialize for SceneJson<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let scene = self.0;
        let (frame, per_unit) = match scene.frame {
            FRAME_FLOOR => ("floor", 1e6),
            _ => ("image", 1e4),
        };
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("sequence", &scene.sequence)?;
        map.serialize_entry("stamp_ns", &scene.stamp_ns)?;
        map.serialize_entry("frame", frame)?;
        let light = match scene.light {
            LIGHT_DARK => "dark",
            LIGHT_CHANGED => "changed",
            _ => "steady",
        };
        map.serialize_entry("light", light)?;
        let gain = scene.gain.map(|gain| rounded(f64::from(gain), 1e3));
        map.serialize_entry("gain", &gain)?;
        match scene.source {
            SOURCE_WAITING => {
                map.serialize_entry("source", "waiting")?;
                let age_s = rounded(f64::from(scene.frame_age_s), 1e3);
                map.serialize_entry("frame_age", &age_s)?;
            }
            _ => map.serialize_entry("source", "running")?,
        }
        if scene.n_overflow > 0 {
            map.serialize_entry("overflow", &scene.n_overflow)?;
        }
        let objects = scene.objects().iter();
        map.serialize_entry(
            "objects",
            &Sequence(objects.map(|object| ObjectJson { object, per_unit })),
        )?;
        map.end()
    }
}

struct ObjectJson<'a> {
    object: &'a Object,
    /// Steps of a length per unit of the scene's frame.
    per_unit: f64,
}

impl Serialize for ObjectJson<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { object, per_unit } = *self;
        let length = |value| rounded(value, per_unit);
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("track", &object.track)?;
        map.serialize_entry(
            "kind",
            match object.kind {
                KIND_MARKER => "marker",
                _ => "obstacle",
            },
        )?;
        if let Some(name) = object.marker_name() {
            map.serialize_entry("marker", name)?;
        }
        map.serialize_entry("x", &length(object.x))?;
        map.serialize_entry("y", &length(object.y))?;
        if let Some(heading_rad) = object.heading() {
            map.serialize_entry("heading", &rounded(heading_rad, PER_RADIAN))?;
        }
        map.serialize_entry("size", &length(object.size))?;
        map.serialize_entry("vx", &length(object.vx))?;
        map.serialize_entry("vy", &length(object.vy))?;
        map.serialize_entry("turn_rate", &rounded(object.turn_rate_rad_s, PER_RADIAN))?;
        map.serialize_entry("age", &rounded(object.age_s, PER_SECOND))?;
        map.serialize_entry("observed", &object.observed())?;
        if object.confidence > 0.0 {
            map.serialize_entry("confidence", &rounded(object.confidence, PER_ONE))?;
        }
        match object.heading() {
            Some(_) => map.serialize_entry("covariance", &significant(&object.covariance))?,
            None => {
                let [[xx, xy, _], [yx, yy, _], _] = object.covariance;
                map.serialize_entry("covariance", &significant(&[[xx, xy], [yx, yy]]))?;
            }
        }
        let outline = object.outline().iter();
        map.serialize_entry("outline", &Sequence(outline.map(|point| point.map(length))))?;
        let forecast = object.forecast().iter();
        map.serialize_entry(
            "forecast",
            &Sequence(forecast.map(|point| ForecastJson::new(point, per_unit))),
        )?;
        map.end()
    }
}

#[derive(Serialize)]
struct ForecastJson {
    dt: f64,
    x: f64,
    y: f64,
    covariance: [[f64; 2]; 2],
}

impl ForecastJson {
    fn new(point: &ForecastPoint, per_unit: f64) -> Self {
        Self {
            dt: rounded(point.dt_s, PER_SECOND),
            x: rounded(point.x, per_unit),
            y: rounded(point.y, per_unit),
            covariance: significant(&point.covariance),
        }
    }
}

/// A JSON array written from an iterator, without collecting it first.
struct Sequence<I>(I);

impl<I> Serialize for Sequence<I>
where
    I: Iterator<Item: Serialize> + Clone,
{
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut sequence = serializer.serialize_seq(None)?;
        for element in self.0.clone() {
            sequence.serialize_element(&element)?;
        }
        sequence.end()
    }
}

/// `value` rounded to a whole number of steps. The quotient is the double nearest to the decimal
/// fraction, which has a short decimal form.
fn rounded(value: f64, steps_per_unit: f64) -> f64 {
    let steps = (value * steps_per_unit).round();
    // Adding zero turns -0.0, from a small negative value, into 0.0.
    steps / steps_per_unit + 0.0
}

fn significant<const N: usize>(matrix: &[[f64; N]; N]) -> [[f64; N]; N] {
    matrix.map(|row| row.map(round_significant))
}

/// `value` rounded to six significant digits.
///
/// Scaled by powers of ten that are exact as doubles, so that the result is the double nearest to
/// the decimal fraction. Values below 1e-17, the square of three millionths of a millimetre, become
/// zero.
fn round_significant(value: f64) -> f64 {
    const POWERS_OF_TEN: [f64; 23] = [
        1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
        1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
    ];
    let magnitude = value.abs();
    if magnitude < 1e-17 {
        return 0.0;
    }
    let mut decimals = 0;
    while decimals + 1 < POWERS_OF_TEN.len() && magnitude * POWERS_OF_TEN[decimals] < 1e5 {
        decimals += 1;
    }
    if decimals > 0 {
        return rounded(value, POWERS_OF_TEN[decimals]);
    }
    let mut zeros = 0;
    while zeros + 1 < POWERS_OF_TEN.len() && magnitude / POWERS_OF_TEN[zeros] >= 1e6 {
        zeros += 1;
    }
    (value / POWERS_OF_TEN[zeros]).round() * POWERS_OF_TEN[zeros]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use scene::{HAS_HEADING, KIND_OBSTACLE, OBSERVED};

    fn line(scene: &Scene) -> String {
        let mut bytes = Vec::new();
        write_line(scene, &mut bytes).expect("a vector takes it");
        String::from_utf8(bytes).expect("JSON is UTF-8")
    }

    fn robot_and_box() -> Scene {
        let mut scene = Scene::EMPTY;
        scene.sequence = 17;
        scene.stamp_ns = 1_133_333_333;
        scene.published_ns = 99;
        scene.n_objects = 2;

        let robot = &mut scene.objects[0];
        robot.track = 3;
        robot.kind = KIND_MARKER;
        robot.flags = OBSERVED | HAS_HEADING;
        robot.marker[..5].copy_from_slice(b"arrow");
        (robot.x, robot.y) = (101.520_04, 88.069_96);
        robot.heading_rad = std::f64::consts::FRAC_PI_2;
        robot.size = 24.1;
        robot.confidence = 0.987_654;
        (robot.vx, robot.vy) = (-0.000_04, -31.2);
        (robot.turn_rate_rad_s, robot.age_s) = (-0.25, 1.533_333_333);
        robot.covariance = [
            [0.012_345_678, -1e-20, 0.0],
            [-1e-20, 1_234.567_89, 0.5],
            [0.0, 0.5, 3.141_592_65e-7],
        ];
        robot.n_outline = 2;
        robot.outline[0] = [90.0, 80.25];
        robot.outline[1] = [112.0, 80.25];
        robot.n_forecast = 2;
        robot.forecast[0] = ForecastPoint {
            dt_s: 1.0 / 15.0,
            x: 101.52,
            y: 85.99,
            covariance: [[0.02, 0.0], [0.0, 0.02]],
        };
        robot.forecast[1] = ForecastPoint {
            dt_s: 2.0 / 15.0,
            x: 101.52,
            y: 83.91,
            covariance: [[0.1, 0.01], [0.01, 1234567.0]],
        };

        let obstacle = &mut scene.objects[1];
        obstacle.track = 5;
        obstacle.kind = KIND_OBSTACLE;
        (obstacle.x, obstacle.y) = (10.0, 20.5);
        obstacle.size = 8.0;
        obstacle.covariance = [[0.25, 0.0, 7.0], [0.0, 0.25, 7.0], [7.0, 7.0, 7.0]];
        scene
    }

    #[test]
    fn a_scene_in_pixels() {
        let expected = concat!(
            r#"{"sequence":17,"stamp_ns":1133333333,"frame":"image","light":"steady","gain":[1.0,1.0,1.0],"source":"running","objects":["#,
            r#"{"track":3,"kind":"marker","marker":"arrow","x":101.52,"y":88.07,"heading":1.570796,"size":24.1,"#,
            r#""vx":0.0,"vy":-31.2,"turn_rate":-0.25,"age":1.533333,"observed":true,"confidence":0.9877,"#,
            r#""covariance":[[0.0123457,0.0,0.0],[0.0,1234.57,0.5],[0.0,0.5,3.14159e-7]],"#,
            r#""outline":[[90.0,80.25],[112.0,80.25]],"#,
            r#""forecast":[{"dt":0.066667,"x":101.52,"y":85.99,"covariance":[[0.02,0.0],[0.0,0.02]]},"#,
            r#"{"dt":0.133333,"x":101.52,"y":83.91,"covariance":[[0.1,0.01],[0.01,1234570.0]]}]},"#,
            r#"{"track":5,"kind":"obstacle","x":10.0,"y":20.5,"size":8.0,"vx":0.0,"vy":0.0,"#,
            r#""turn_rate":0.0,"age":0.0,"observed":false,"#,
            r#""covariance":[[0.25,0.0],[0.0,0.25]],"outline":[],"forecast":[]}]}"#,
            "\n"
        );
        assert_eq!(line(&robot_and_box()), expected);
    }

    #[test]
    fn a_scene_on_the_floor_is_finer_and_an_empty_one_is_a_line_too() {
        let mut scene = robot_and_box();
        scene.frame = FRAME_FLOOR;
        scene.n_objects = 1;
        scene.objects[0].x = 1.234_567_8;
        let text = line(&scene);
        assert!(text.contains(r#""frame":"floor""#), "{text}");
        assert!(text.contains(r#""x":1.234568,"y":88.06996,"#), "{text}");

        let mut empty = Scene::EMPTY;
        assert_eq!(
            line(&empty),
            "{\"sequence\":0,\"stamp_ns\":0,\"frame\":\"image\",\"light\":\"steady\",\"gain\":[1.0,1.0,1.0],\"source\":\"running\",\"objects\":[]}\n"
        );
        empty.n_overflow = 3;
        assert_eq!(
            line(&empty),
            "{\"sequence\":0,\"stamp_ns\":0,\"frame\":\"image\",\"light\":\"steady\",\"gain\":[1.0,1.0,1.0],\"source\":\"running\",\"overflow\":3,\"objects\":[]}\n"
        );
    }

    #[test]
    fn a_scene_without_a_frame_says_how_old_the_last_one_is() {
        let mut scene = Scene::EMPTY;
        (scene.source, scene.frame_age_s) = (SOURCE_WAITING, 1.234_567);
        let text = line(&scene);
        assert!(
            text.contains(r#""source":"waiting","frame_age":1.235,"#),
            "{text}"
        );
    }

    #[test]
    fn what_is_not_finite_is_null() {
        let mut scene = robot_and_box();
        scene.n_objects = 1;
        scene.objects[0].x = f64::NAN;
        scene.objects[0].vy = f64::NEG_INFINITY;
        scene.objects[0].covariance[0][0] = f64::INFINITY;
        scene.objects[0].covariance[1][1] = f64::NAN;
        let parsed: serde_json::Value = serde_json::from_str(&line(&scene)).expect("it is JSON");
        let robot = &parsed["objects"][0];
        assert!(robot["x"].is_null() && robot["vy"].is_null());
        assert!(robot["covariance"][0][0].is_null() && robot["covariance"][1][1].is_null());
        assert_eq!(robot["y"], 88.07);
    }

    proptest! {
        #[test]
        fn six_digits_are_those_that_formatting_gives(mantissa in -10.0..10.0f64, exponent in -15..25i32) {
            let value = mantissa * 10f64.powi(exponent);
            if value.abs() < 1e-17 {
                prop_assert_eq!(round_significant(value), 0.0);
                return Ok(());
            }
            let naive: f64 = format!("{value:.5e}").parse().expect("a number");
            let close = (round_significant(value) - naive).abs() <= 1e-5 * value.abs();
            prop_assert!(close, "{value:e}: {:e} instead of {naive:e}", round_significant(value));
            let digits = format!("{:e}", round_significant(value));
            let mantissa = digits.split('e').next().expect("a mantissa");
            prop_assert!(mantissa.trim_start_matches('-').len() <= 8, "{value:e} became {digits}");
        }

        #[test]
        fn rounding_prints_no_more_decimals_than_its_resolution(value in -1e5..1e5f64) {
            for (steps, decimals) in [(1e4, 4), (1e6, 6)] {
                let text = serde_json::to_string(&rounded(value, steps)).expect("a number");
                let fraction = text.split_once('.').map_or("", |(_, fraction)| fraction);
                prop_assert!(fraction.len() <= decimals || text.contains('e'), "{value} became {text}");
                prop_assert!((rounded(value, steps) - value).abs() <= 0.500_01 / steps);
                prop_assert!(text != "-0.0");
            }
        }
    }
}
