//! Selects the controls of a camera to lock, their values, and the report about it. All decisions
//! here are functions of the values stated by the camera;
//! [`Camera::start`](crate::camera::Camera::start) reads, waits and writes.
//!
//! If an automatic adjusts exposure or white balance, every pixel deviates from the learned
//! background at once, and everything becomes an object. Hence at the start:
//!
//! 1. Values given by the user are written, after their automatic is switched off. They must be
//!    accepted exactly, or the run does not start.
//! 2. If automatics are on, frames are discarded for a second, so that the automatics settle on the
//!    real scene. An automatic exposure must not reduce the frame rate meanwhile
//!    (`EXPOSURE_AUTO_PRIORITY`), since a rate was negotiated. Without automatics there is no wait.
//! 3. The values are read and the automatics switched off. Values changed by this are written back.
//!    Unchanged ones are not written: while automatic, many cameras state an old exposure value,
//!    and often keep the true one as long as nothing is written.
//! 4. Everything is read again and reported. If the picture has become brighter or darker by more
//!    than `BRIGHTNESS_RATIO_MAX`, the value read was wrong: exposure and gain are returned to the
//!    automatics.
//!
//! A control that the camera does not have or refuses to change does not stop the run, unless its
//! value was given by the user. When the camera is closed, everything written is restored, since
//! the next program expects a camera with working automatics; if the program was killed, the next
//! run restores it first (`written`).
//!
//! A camera that was unplugged returns with its power-on values. The locked values are written
//! again, without another second of waiting.
//!
//! # Deliberately absent
//!
//! Brightness, contrast and the like, which do not change by themselves. The power line frequency,
//! which depends on the location. Vendor-specific controls.
//!
//! Source: Linux Media Subsystem Documentation, "User Controls" and "Camera Control Reference";
//! numbers from `linux/v4l2-controls.h`.

mod written;

use std::io;

use serde::{Deserialize, Serialize};

use crate::camera::v4l2::{ControlRange, Device};
pub(crate) use written::{Written, state_folder};

const USER: u32 = 0x0098_0900;
const CAMERA: u32 = 0x009a_0900;

const AUTO_WHITE_BALANCE: u32 = USER + 12;
const RED_BALANCE: u32 = USER + 14;
const BLUE_BALANCE: u32 = USER + 15;
const EXPOSURE: u32 = USER + 17;
const AUTOGAIN: u32 = USER + 18;
const GAIN: u32 = USER + 19;
const WHITE_BALANCE_TEMPERATURE: u32 = USER + 26;
const EXPOSURE_AUTO: u32 = CAMERA + 1;
const EXPOSURE_ABSOLUTE: u32 = CAMERA + 2;
const EXPOSURE_AUTO_PRIORITY: u32 = CAMERA + 3;
const FOCUS_ABSOLUTE: u32 = CAMERA + 10;
const FOCUS_AUTO: u32 = CAMERA + 12;

/// The menu item of `EXPOSURE_AUTO` for which neither time nor iris is automatic; switches are off
/// at 0.
const EXPOSURE_MANUAL: i32 = 1;
const OFF: i32 = 0;

/// Maximum factor by which locking may change the mean of the picture, in either direction. Objects
/// that come and go change it less, and a background learned after the change is not affected much.
pub(crate) const BRIGHTNESS_RATIO_MAX: f64 = 1.25;
/// A smaller change of the mean (0 to 255) is noise of a dark picture.
const BRIGHTNESS_STEP_MIN: f64 = 8.0;

/// Controls requested by the user. The default is to lock all of them at the values found by the
/// automatics.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ControlRequest {
    /// Leave the automatics on, except for the values given here.
    pub camera_auto: bool,
    /// Exposure time in microseconds.
    pub exposure_us: Option<u32>,
    /// Gain, in the camera's own unit.
    pub gain: Option<i32>,
    /// Colour temperature of the white balance, in kelvins.
    pub white_balance_k: Option<u32>,
    /// Distance of the focus, in the camera's own unit.
    pub focus: Option<i32>,
}

/// Reasons why a value given by the user cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// The camera has no such control, or it is read-only.
    #[error("has no {name} that can be set: leave {flag} out")]
    NotOffered {
        /// Name of the control.
        name: &'static str,
        /// The argument.
        flag: &'static str,
    },
    /// The value is not in the range of the camera.
    #[error("{flag} {asked}: the camera has {min} to {max}{unit} in steps of {step}")]
    Range {
        /// The argument.
        flag: &'static str,
        /// Its value.
        asked: i64,
        /// Smallest value, in the argument's unit.
        min: i64,
        /// Largest value.
        max: i64,
        /// Step between values.
        step: i64,
        /// The unit, if there is one.
        unit: &'static str,
    },
    /// The camera refused to change the value or its automatic.
    #[error("{flag} {asked}: the camera refuses it ({source}): leave it out")]
    Refused {
        /// The argument.
        flag: &'static str,
        /// Its value.
        asked: i64,
        /// Error of the system.
        source: io::Error,
    },
    /// The camera accepted the value but has another one.
    #[error("{flag} {asked}: the camera has {actual} instead: give another value, or leave it out")]
    Changed {
        /// The argument.
        flag: &'static str,
        /// Its value.
        asked: i64,
        /// Value stated by the camera, in the argument's unit.
        actual: String,
    },
}

/// A setting that affects every pixel: the switch of its automatic, and the values it controls.
struct Setting {
    name: &'static str,
    flag: &'static str,
    asked: fn(&ControlRequest) -> Option<i64>,
    automatic: u32,
    /// The automatic's value when it is off.
    off: i32,
    /// The user can give the first of them.
    values: &'static [Value],
    /// Whether it affects brightness.
    is_brightness: bool,
}

/// A control with a numeric value.
struct Value {
    id: u32,
    name: &'static str,
    /// Size of one step of the control, in the unit.
    scale: i64,
    unit: &'static str,
}

const fn value(id: u32, name: &'static str, scale: i64, unit: &'static str) -> Value {
    Value {
        id,
        name,
        scale,
        unit,
    }
}

const SETTINGS: [Setting; 4] = [
    Setting {
        name: "exposure",
        flag: "--exposure",
        asked: |request| request.exposure_us.map(i64::from),
        automatic: EXPOSURE_AUTO,
        off: EXPOSURE_MANUAL,
        values: &[
            value(EXPOSURE_ABSOLUTE, "exposure", 100, " us"),
            // For older drivers, each with a unit of its own.
            value(EXPOSURE, "exposure level", 1, ""),
        ],
        is_brightness: true,
    },
    Setting {
        name: "gain",
        flag: "--gain",
        asked: |request| request.gain.map(i64::from),
        automatic: AUTOGAIN,
        off: OFF,
        values: &[value(GAIN, "gain", 1, "")],
        is_brightness: true,
    },
    Setting {
        name: "white balance",
        flag: "--white-balance",
        asked: |request| request.white_balance_k.map(i64::from),
        automatic: AUTO_WHITE_BALANCE,
        off: OFF,
        values: &[
            value(WHITE_BALANCE_TEMPERATURE, "white balance", 1, " K"),
            value(RED_BALANCE, "red balance", 1, ""),
            value(BLUE_BALANCE, "blue balance", 1, ""),
        ],
        is_brightness: false,
    },
    Setting {
        name: "focus",
        flag: "--focus",
        asked: |request| request.focus.map(i64::from),
        automatic: FOCUS_AUTO,
        off: OFF,
        values: &[value(FOCUS_ABSOLUTE, "focus", 1, "")],
        is_brightness: false,
    },
];

/// A control that a camera has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Control {
    id: u32,
    range: ControlRange,
    /// `None` if the camera does not state it.
    value: Option<i32>,
}

/// State of the relevant controls that a camera has.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Controls(Vec<Control>);

/// A value to write or restore.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Change {
    pub(crate) id: u32,
    pub(crate) value: i32,
}

/// Result of switching the automatics off.
#[derive(Debug, Default)]
pub(crate) struct Attempt {
    /// Automatics that were to be switched off, with the result of each.
    pub(crate) switched: Vec<(Change, io::Result<()>)>,
    /// Ratio of new to old brightness, if it was so large that locking was undone.
    pub(crate) undone_by: Option<f64>,
}

impl Controls {
    /// Reads the controls from the camera.
    pub(crate) fn read(device: &Device) -> Self {
        let ids = SETTINGS.iter().flat_map(|setting| {
            let values = setting.values.iter().map(|value| value.id);
            values.chain([setting.automatic])
        });
        let found = ids.chain([EXPOSURE_AUTO_PRIORITY]).filter_map(|id| {
            Some(Control {
                id,
                range: device.control(id)?,
                value: device.control_value(id).ok(),
            })
        });
        Self(found.collect())
    }

    fn get(&self, id: u32) -> Option<&Control> {
        self.0.iter().find(|control| control.id == id)
    }

    fn value(&self, id: u32) -> Option<i32> {
        self.get(id)?.value
    }

    /// Whether a setting has an automatic that is not off.
    fn is_automatic(&self, setting: &Setting) -> bool {
        self.get(setting.automatic)
            .is_some_and(|control| control.value != Some(setting.off))
    }

    fn has(&self, setting: &Setting) -> bool {
        let mut values = setting.values.iter();
        self.get(setting.automatic).is_some() || values.any(|value| self.get(value.id).is_some())
    }

    /// The changes for the values given by the user.
    pub(crate) fn by_hand(&self, request: &ControlRequest) -> Result<Vec<Change>, ControlError> {
        let mut changes = Vec::new();
        for setting in &SETTINGS {
            let (flag, value) = (setting.flag, &setting.values[0]);
            let Some(asked) = (setting.asked)(request) else {
                continue;
            };
            let range = match self.get(value.id) {
                Some(control) if control.range.is_writable => control.range,
                _ => {
                    let name = setting.name;
                    return Err(ControlError::NotOffered { name, flag });
                }
            };
            let [min, max, step] = [range.min, range.max, range.step].map(i64::from);
            let steps = asked / value.scale;
            let is_offered = asked % value.scale == 0
                && (min..=max).contains(&steps)
                && (steps - min) % step == 0;
            let Some(written) = i32::try_from(steps).ok().filter(|_| is_offered) else {
                return Err(ControlError::Range {
                    flag,
                    asked,
                    min: min * value.scale,
                    max: max * value.scale,
                    step: step * value.scale,
                    unit: value.unit,
                });
            };
            if self.is_automatic(setting) {
                changes.push(setting.switch_off());
            }
            changes.push(Change {
                id: value.id,
                value: written,
            });
        }
        Ok(changes)
    }

    /// Checks whether the camera has the values given by the user.
    pub(crate) fn check_by_hand(&self, request: &ControlRequest) -> Result<(), ControlError> {
        for setting in &SETTINGS {
            let Some(asked) = (setting.asked)(request) else {
                continue;
            };
            let value = &setting.values[0];
            let actual = match self.value(value.id) {
                _ if self.is_automatic(setting) => "its automatic on".to_owned(),
                Some(actual) if i64::from(actual) * value.scale != asked => {
                    format!("{}{}", i64::from(actual) * value.scale, value.unit)
                }
                _ => continue,
            };
            return Err(ControlError::Changed {
                flag: setting.flag,
                asked,
                actual,
            });
        }
        Ok(())
    }

    /// The automatics to switch off after they have settled.
    pub(crate) fn to_switch_off(&self, request: &ControlRequest) -> Vec<Change> {
        let to_lock = |setting: &&Setting| {
            !request.camera_auto && (setting.asked)(request).is_none() && self.is_automatic(setting)
        };
        let settings = SETTINGS.iter().filter(to_lock);
        settings.map(Setting::switch_off).collect()
    }

    /// The change that prevents an automatic exposure from reducing the frame rate, if it is to be
    /// locked.
    pub(crate) fn to_keep_rate(&self, switch_off: &[Change]) -> Option<Change> {
        let is_locked = switch_off.iter().any(|change| change.id == EXPOSURE_AUTO);
        let is_slowed = self
            .value(EXPOSURE_AUTO_PRIORITY)
            .is_some_and(|on| on != OFF);
        (is_locked && is_slowed).then_some(Change {
            id: EXPOSURE_AUTO_PRIORITY,
            value: OFF,
        })
    }

    /// The values that differ from those `before` the automatics were switched off.
    pub(crate) fn to_put_back(&self, before: &Self, request: &ControlRequest) -> Vec<Change> {
        let is_locked =
            |setting: &&Setting| (setting.asked)(request).is_none() && !self.is_automatic(setting);
        let values = SETTINGS.iter().filter(is_locked).flat_map(|s| s.values);
        values
            .filter_map(|&Value { id, .. }| {
                let control = self.get(id)?;
                let value = before.value(id)?;
                let is_to_write = control.range.is_writable && control.value != Some(value);
                is_to_write.then_some(Change { id, value })
            })
            .collect()
    }

    /// The changes that restore this state on a camera in the state `now`, except for what is
    /// automatic here: first the automatics to switch off, and once they are off, the values.
    pub(crate) fn to_set_again(&self, now: &Self) -> Vec<Change> {
        let is_fixed = |setting: &&Setting| self.has(setting) && !self.is_automatic(setting);
        let fixed = || SETTINGS.iter().filter(is_fixed);
        let automatics: Vec<Change> = fixed()
            .filter(|setting| now.is_automatic(setting))
            .map(Setting::switch_off)
            .collect();
        if !automatics.is_empty() {
            return automatics;
        }
        let values = fixed().flat_map(|setting| setting.values);
        values
            .filter_map(|&Value { id, .. }| {
                let (then, now) = (self.get(id)?, now.get(id)?);
                let value = then.value.filter(|_| now.range.is_writable)?;
                (now.value != Some(value)).then_some(Change { id, value })
            })
            .collect()
    }

    /// Report for the user in one line: the locked settings with their values, and those not locked
    /// with the reason.
    pub(crate) fn report(&self, request: &ControlRequest, attempt: &Attempt) -> String {
        let [mut locked, mut given, mut fixed, mut automatic, mut missing] = [const { vec![] }; 5];
        for setting in &SETTINGS {
            let switched = attempt
                .switched
                .iter()
                .find(|(change, _)| change.id == setting.automatic);
            if !self.has(setting) {
                missing.push(setting.name.to_owned());
            } else if self.is_automatic(setting) {
                automatic.push(match (attempt.undone_by, switched) {
                    (_, Some((_, Err(error)))) => format!("{} ({error})", setting.name),
                    (Some(ratio), Some(_)) if setting.is_brightness => {
                        let (flag, change) = (setting.flag, brightness_text(ratio));
                        let name = setting.name;
                        format!("{name} (locked, the picture was {change}; give {flag})")
                    }
                    (_, Some(_)) => format!("{} (it does not switch off)", setting.name),
                    (_, None) => setting.name.to_owned(),
                });
            } else if (setting.asked)(request).is_some() {
                given.push(self.values_text(setting));
            } else if switched.is_some() {
                locked.push(self.values_text(setting));
            } else {
                fixed.push(self.values_text(setting));
            }
        }
        if missing.len() == SETTINGS.len() {
            return format!("no control of {}", missing.join(", "));
        }
        let parts = [
            ("locked", locked),
            ("given", given),
            ("fixed already", fixed),
            ("automatic", automatic),
            ("no control of", missing),
        ];
        let parts: Vec<String> = parts
            .iter()
            .filter(|(_, names)| !names.is_empty())
            .map(|(what, names)| format!("{what} {}", names.join(", ")))
            .collect();
        parts.join("; ")
    }

    /// The values of a setting, with units; only its name if the camera does not state them.
    fn values_text(&self, setting: &Setting) -> String {
        let values: Vec<String> = setting
            .values
            .iter()
            .filter_map(|value| {
                let number = i64::from(self.value(value.id)?) * value.scale;
                Some(format!("{} {number}{}", value.name, value.unit))
            })
            .collect();
        match values.is_empty() {
            true => format!(
                "{} (at a value that the camera does not tell)",
                setting.name
            ),
            false => values.join(", "),
        }
    }

    /// One line for each value that a camera has, with its range, and for each automatic without a
    /// value.
    pub(crate) fn describe(&self) -> Vec<String> {
        let mut lines = Vec::new();
        for setting in SETTINGS.iter().filter(|setting| self.has(setting)) {
            let automatic = match self.get(setting.automatic) {
                None => "",
                Some(_) if self.is_automatic(setting) => ", automatic",
                Some(_) => ", automatic off",
            };
            let n_before = lines.len();
            for value in setting.values {
                let Some(Control {
                    range, value: now, ..
                }) = self.get(value.id)
                else {
                    continue;
                };
                let scaled = |number: i32| i64::from(number) * value.scale;
                let (name, unit) = (value.name, value.unit);
                let [min, max, step] = [range.min, range.max, range.step].map(scaled);
                let now = now.map_or("unknown".to_owned(), |now| scaled(now).to_string());
                let step = match step {
                    1 => String::new(),
                    step => format!(" in steps of {step}"),
                };
                lines.push(format!(
                    "{name}: {min} to {max}{unit}{step}, now {now}{automatic}"
                ));
            }
            if lines.len() == n_before {
                lines.push(format!("{}: no value{automatic}", setting.name));
            }
        }
        lines
    }
}

impl Setting {
    fn switch_off(&self) -> Change {
        Change {
            id: self.automatic,
            value: self.off,
        }
    }
}

/// The error for a change that was refused, in terms of the user's argument.
pub(crate) fn refused(change: Change, request: &ControlRequest, source: io::Error) -> ControlError {
    let setting = SETTINGS
        .iter()
        .find(|setting| setting.automatic == change.id || setting.values[0].id == change.id);
    let (flag, asked) = setting.map_or(("the control", None), |setting| {
        (setting.flag, (setting.asked)(request))
    });
    ControlError::Refused {
        flag,
        asked: asked.unwrap_or(i64::from(change.value)),
        source,
    }
}

/// Ratio of new to old brightness (means, 0 to 255), if it exceeds normal changes of a scene.
pub(crate) fn brightness_jump(before: f64, after: f64) -> Option<f64> {
    let ratio = after.max(1.0) / before.max(1.0);
    let is_jump = ratio.max(1.0 / ratio) > BRIGHTNESS_RATIO_MAX
        && (after - before).abs() >= BRIGHTNESS_STEP_MIN;
    is_jump.then_some(ratio)
}

fn brightness_text(ratio: f64) -> String {
    match ratio < 1.0 {
        true => format!("{:.1} times darker", 1.0 / ratio),
        false => format!("{ratio:.1} times brighter"),
    }
}

#[cfg(test)]
mod tests;
