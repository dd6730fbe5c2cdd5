//! Cameras as tables of plain data: the changes made to each, and the report about it.

use super::*;

/// A writable control, as `(id, min, max, step, value)`.
type Row = (u32, i32, i32, i32, i32);

fn camera(rows: &[Row]) -> Controls {
    let control = |&(id, min, max, step, value): &Row| Control {
        id,
        range: ControlRange {
            min,
            max,
            step,
            is_writable: true,
        },
        value: Some(value),
    };
    Controls(rows.iter().map(control).collect())
}

/// A typical webcam: everything is automatic; the gain has no automatic of its own and follows the
/// exposure.
const WEBCAM: [Row; 8] = [
    (EXPOSURE_AUTO, 0, 3, 1, 3),
    (EXPOSURE_ABSOLUTE, 3, 2047, 1, 156),
    (EXPOSURE_AUTO_PRIORITY, 0, 1, 1, 1),
    (GAIN, 0, 255, 1, 64),
    (AUTO_WHITE_BALANCE, 0, 1, 1, 1),
    (WHITE_BALANCE_TEMPERATURE, 2000, 6500, 10, 4600),
    (FOCUS_AUTO, 0, 1, 1, 1),
    (FOCUS_ABSOLUTE, 0, 250, 5, 30),
];

/// The camera after some changes, all of which it accepts.
fn changed(mut camera: Controls, changes: &[Change]) -> Controls {
    for change in changes {
        for control in &mut camera.0 {
            if control.id == change.id {
                control.value = Some(change.value);
            }
        }
    }
    camera
}

fn pairs(changes: &[Change]) -> Vec<(u32, i32)> {
    changes.iter().map(|c| (c.id, c.value)).collect()
}

fn accepted(changes: Vec<Change>) -> Attempt {
    Attempt {
        switched: changes.into_iter().map(|change| (change, Ok(()))).collect(),
        undone_by: None,
    }
}

fn denied(error: i32) -> io::Result<()> {
    Err(io::Error::from_raw_os_error(error))
}

const LOCK: ControlRequest = ControlRequest {
    camera_auto: false,
    exposure_us: None,
    gain: None,
    white_balance_k: None,
    focus: None,
};

#[test]
fn everything_automatic_is_switched_off() {
    let camera = camera(&WEBCAM);
    assert_eq!(LOCK, ControlRequest::default());
    let off = camera.to_switch_off(&LOCK);
    let expected = [
        (EXPOSURE_AUTO, EXPOSURE_MANUAL),
        (AUTO_WHITE_BALANCE, 0),
        (FOCUS_AUTO, 0),
    ];
    assert_eq!(pairs(&off), expected);
    let kept = camera.to_keep_rate(&off).expect("the rate may vary");
    assert_eq!((kept.id, kept.value), (EXPOSURE_AUTO_PRIORITY, 0));
    assert!(camera.by_hand(&LOCK).expect("nothing given").is_empty());

    let locked = changed(camera, &off);
    assert!(locked.to_switch_off(&LOCK).is_empty());
    assert_eq!(
        locked.report(&LOCK, &accepted(off)),
        "locked exposure 15600 us, white balance 4600 K, focus 30; fixed already gain 64"
    );
}

#[test]
fn what_is_fixed_already_needs_nothing() {
    let fixed = camera(&[
        (EXPOSURE_AUTO, 0, 3, 1, 1),
        (EXPOSURE_ABSOLUTE, 3, 2047, 1, 100),
        (EXPOSURE_AUTO_PRIORITY, 0, 1, 1, 1),
        (AUTOGAIN, 0, 1, 1, 0),
    ]);
    let off = fixed.to_switch_off(&LOCK);
    assert!(off.is_empty());
    assert_eq!(fixed.to_keep_rate(&off), None);
    assert_eq!(
        fixed.report(&LOCK, &Attempt::default()),
        "fixed already exposure 10000 us, gain (at a value that the camera does not tell); \
         no control of white balance, focus"
    );
}

#[test]
fn a_camera_without_controls_is_tolerated() {
    let none = camera(&[]);
    assert!(none.to_switch_off(&LOCK).is_empty());
    assert!(none.by_hand(&LOCK).expect("nothing given").is_empty());
    assert_eq!(
        none.report(&LOCK, &Attempt::default()),
        "no control of exposure, gain, white balance, focus"
    );
    assert!(none.describe().is_empty());
}

#[test]
fn values_that_switching_off_has_changed_are_written_back() {
    let before = camera(&WEBCAM);
    let off = before.to_switch_off(&LOCK);
    let mut after = changed(before.clone(), &off);
    assert!(after.to_put_back(&before, &LOCK).is_empty());
    let reset = |id, value| Change { id, value };
    let resets = [
        reset(EXPOSURE_ABSOLUTE, 500),
        reset(GAIN, 0),
        reset(FOCUS_ABSOLUTE, 0),
    ];
    after = changed(after, &resets);
    let expected = [(EXPOSURE_ABSOLUTE, 156), (GAIN, 64), (FOCUS_ABSOLUTE, 30)];
    assert_eq!(pairs(&after.to_put_back(&before, &LOCK)), expected);

    // Values given by the user, still automatic, or read-only are skipped.
    let request = ControlRequest {
        gain: Some(0),
        ..LOCK
    };
    after = changed(after, &[reset(FOCUS_AUTO, 1)]);
    after.0[1].range.is_writable = false;
    assert!(after.to_put_back(&before, &request).is_empty());
}

#[test]
fn values_given_by_hand_are_written_exactly() {
    let camera = camera(&WEBCAM);
    let request = ControlRequest {
        exposure_us: Some(10_000),
        gain: Some(255),
        white_balance_k: Some(4010),
        ..LOCK
    };
    let by_hand = camera.by_hand(&request).expect("all of it is offered");
    let expected = [
        (EXPOSURE_AUTO, EXPOSURE_MANUAL),
        (EXPOSURE_ABSOLUTE, 100),
        (GAIN, 255),
        (AUTO_WHITE_BALANCE, 0),
        (WHITE_BALANCE_TEMPERATURE, 4010),
    ];
    assert_eq!(pairs(&by_hand), expected);
    let error = camera.check_by_hand(&request).expect_err("not yet written");
    assert!(error.to_string().contains("its automatic on"), "{error}");

    let mut current = changed(camera, &by_hand);
    current.check_by_hand(&request).expect("accepted");
    let off = current.to_switch_off(&request);
    assert_eq!(pairs(&off), [(FOCUS_AUTO, 0)]);
    assert_eq!(current.to_keep_rate(&off), None);
    current = changed(current, &off);
    assert_eq!(
        current.report(&request, &accepted(off)),
        "locked focus 30; given exposure 10000 us, gain 255, white balance 4010 K"
    );
    let clipped = Change {
        id: EXPOSURE_ABSOLUTE,
        value: 99,
    };
    let error = changed(current, &[clipped]).check_by_hand(&request);
    assert_eq!(
        error.expect_err("not what was asked for").to_string(),
        "--exposure 10000: the camera has 9900 us instead: give another value, or leave it out"
    );
}

#[test]
fn automatics_stay_on_on_request_except_for_given_values() {
    let request = ControlRequest {
        camera_auto: true,
        focus: Some(0),
        ..LOCK
    };
    let camera = camera(&WEBCAM);
    assert!(camera.to_switch_off(&request).is_empty());
    let by_hand = camera.by_hand(&request).expect("offered");
    assert_eq!(pairs(&by_hand), [(FOCUS_AUTO, 0), (FOCUS_ABSOLUTE, 0)]);
    assert_eq!(
        changed(camera, &by_hand).report(&request, &Attempt::default()),
        "given focus 0; fixed already gain 64; automatic exposure, white balance"
    );
}

#[test]
fn values_that_the_camera_does_not_have_are_refused() {
    let mut webcam = camera(&WEBCAM);
    let refusal = |camera: &Controls, request: ControlRequest| {
        let error = camera.by_hand(&request).expect_err("not offered");
        error.to_string()
    };
    let exposure = |us| ControlRequest {
        exposure_us: Some(us),
        ..LOCK
    };
    for us in [200, 204_800, 10_050, u32::MAX] {
        assert_eq!(
            refusal(&webcam, exposure(us)),
            format!("--exposure {us}: the camera has 300 to 204700 us in steps of 100")
        );
    }
    let gain = |gain| ControlRequest {
        gain: Some(gain),
        ..LOCK
    };
    for value in [-1, 256, i32::MIN] {
        assert_eq!(
            refusal(&webcam, gain(value)),
            format!("--gain {value}: the camera has 0 to 255 in steps of 1")
        );
    }
    let focus = ControlRequest {
        focus: Some(31),
        ..LOCK
    };
    assert_eq!(
        refusal(&webcam, focus),
        "--focus 31: the camera has 0 to 250 in steps of 5"
    );
    let kelvin = ControlRequest {
        white_balance_k: Some(4600),
        ..LOCK
    };
    let expected = "has no white balance that can be set: leave --white-balance out";
    webcam.0[5].range.is_writable = false;
    assert_eq!(refusal(&webcam, kelvin), expected);
    // An exposure in a driver's own unit cannot be given in microseconds.
    let old = camera(&[(EXPOSURE, 0, 255, 1, 120)]);
    assert_eq!(
        refusal(&old, exposure(10_000)),
        "has no exposure that can be set: leave --exposure out"
    );
}

#[test]
fn refusals_are_reported_with_the_reason() {
    let camera = camera(&WEBCAM);
    let off = camera.to_switch_off(&LOCK);
    // The exposure is switched off, the white balance refuses, and the focus only pretends to
    // switch.
    let after = changed(camera, &off[..1]);
    let results = [Ok(()), denied(libc::EBUSY), Ok(())];
    let attempt = Attempt {
        switched: off.into_iter().zip(results).collect(),
        undone_by: None,
    };
    let report = after.report(&LOCK, &attempt);
    assert_eq!(
        report,
        "locked exposure 15600 us; fixed already gain 64; \
         automatic white balance (Device or resource busy (os error 16)), focus (it does not switch off)"
    );
    let request = ControlRequest {
        gain: Some(7),
        ..LOCK
    };
    let change = Change { id: GAIN, value: 7 };
    let error = refused(change, &request, io::Error::from_raw_os_error(libc::EIO));
    assert_eq!(
        error.to_string(),
        "--gain 7: the camera refuses it (Input/output error (os error 5)): leave it out"
    );
}

#[test]
fn a_jump_of_the_brightness_is_reported() {
    let camera = camera(&WEBCAM);
    let off = camera.to_switch_off(&LOCK);
    // The exposure was returned to its automatic.
    let after = changed(camera, &off[1..]);
    let attempt = Attempt {
        undone_by: Some(0.4),
        ..accepted(off)
    };
    assert_eq!(
        after.report(&LOCK, &attempt),
        "locked white balance 4600 K, focus 30; fixed already gain 64; \
         automatic exposure (locked, the picture was 2.5 times darker; give --exposure)"
    );
    assert_eq!(brightness_text(3.0), "3.0 times brighter");
}

#[test]
fn only_large_changes_of_the_brightness_are_jumps() {
    assert_eq!(brightness_jump(100.0, 120.0), None);
    assert_eq!(brightness_jump(100.0, 84.0), None);
    assert_eq!(brightness_jump(100.0, 130.0), Some(1.3));
    assert_eq!(brightness_jump(100.0, 50.0), Some(0.5));
    // Noise of a covered lens; the lens is uncovered.
    assert_eq!(brightness_jump(2.0, 5.0), None);
    assert_eq!(brightness_jump(0.0, 120.0), Some(120.0));
    assert_eq!(brightness_jump(120.0, 0.0), Some(1.0 / 120.0));
}

/// Power-on values of a camera that returns.
#[test]
fn a_camera_that_comes_back_gets_the_values_at_which_it_was_locked() {
    let locked = changed(
        camera(&WEBCAM),
        &[
            Change {
                id: EXPOSURE_AUTO,
                value: EXPOSURE_MANUAL,
            },
            Change {
                id: EXPOSURE_ABSOLUTE,
                value: 99,
            },
            Change {
                id: AUTO_WHITE_BALANCE,
                value: OFF,
            },
        ],
    );
    let back = camera(&WEBCAM);
    let first = locked.to_set_again(&back);
    // The focus was automatic, and remains so.
    assert_eq!(
        pairs(&first),
        [(EXPOSURE_AUTO, EXPOSURE_MANUAL), (AUTO_WHITE_BALANCE, OFF)]
    );
    let back = changed(back, &first);
    let second = locked.to_set_again(&back);
    assert_eq!(pairs(&second), [(EXPOSURE_ABSOLUTE, 99)]);
    assert!(locked.to_set_again(&changed(back, &second)).is_empty());
    // A camera that kept its power.
    assert!(locked.to_set_again(&locked).is_empty());
}

#[test]
fn cameras_are_described_with_units() {
    assert_eq!(
        camera(&WEBCAM).describe(),
        [
            "exposure: 300 to 204700 us in steps of 100, now 15600, automatic",
            "gain: 0 to 255, now 64",
            "white balance: 2000 to 6500 K in steps of 10, now 4600, automatic",
            "focus: 0 to 250 in steps of 5, now 30, automatic",
        ]
    );
    let mut odd = camera(&[
        (AUTO_WHITE_BALANCE, 0, 1, 1, 0),
        (RED_BALANCE, 0, 255, 1, 9),
        (FOCUS_AUTO, 0, 1, 1, 1),
    ]);
    odd.0[1].value = None;
    assert_eq!(
        odd.describe(),
        [
            "red balance: 0 to 255, now unknown, automatic off",
            "focus: no value, automatic",
        ]
    );
}
