use super::*;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use proptest::prelude::*;

/// The input of the decoder.
fn complete(jpeg: &[u8]) -> Result<Cow<'_, [u8]>, JpegError> {
    walk(jpeg).map(|layout| mended(jpeg, &layout))
}

const SIZE: Size = Size {
    width: 37,
    height: 21,
};

/// An image with the standard tables, which this encoder uses unless asked to optimise.
fn encode(color: ColorType, sampling: SamplingFactor) -> Vec<u8> {
    encode_with(color, sampling, |_| {})
}

fn encode_with(
    color: ColorType,
    sampling: SamplingFactor,
    set: impl FnOnce(&mut Encoder<&mut Vec<u8>>),
) -> Vec<u8> {
    let channels = if color == ColorType::Luma { 1 } else { 3 };
    let pixels: Vec<u8> = (0..SIZE.area())
        .flat_map(|i| {
            let (x, y) = (i % SIZE.width, i / SIZE.width);
            let checks = if (x / 5 + y / 3) % 2 == 0 { 200 } else { 30 };
            [checks, (6 * x) as u8, (10 * y) as u8]
                .into_iter()
                .take(channels)
        })
        .collect();
    let mut jpeg = Vec::new();
    let mut encoder = Encoder::new(&mut jpeg, 90);
    encoder.set_sampling_factor(sampling);
    set(&mut encoder);
    encoder
        .encode(&pixels, SIZE.width as u16, SIZE.height as u16, color)
        .expect("encodes");
    jpeg
}

/// An image as sent by a Motion-JPEG camera: without Huffman tables.
fn without_tables(jpeg: &[u8]) -> Vec<u8> {
    let mut stripped = jpeg[..2].to_vec();
    let mut at = 2;
    while jpeg[at + 1] != START_OF_SCAN {
        let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] != HUFFMAN_TABLES {
            stripped.extend(&jpeg[at..end]);
        }
        at = end;
    }
    stripped.extend(&jpeg[at..]);
    stripped
}

#[test]
fn missing_tables_change_nothing() {
    for sampling in [
        SamplingFactor::R_4_4_4,
        SamplingFactor::R_4_2_2,
        SamplingFactor::R_4_2_0,
    ] {
        let jpeg = encode(ColorType::Rgb, sampling);
        let stripped = without_tables(&jpeg);
        assert!(stripped.len() + 400 < jpeg.len());
        let expected = decode_rgb(&jpeg, SIZE).expect("whole");
        assert_eq!(decode_rgb(&stripped, SIZE).expect("mended"), expected);
        let mended = complete(&stripped).expect("whole");
        assert_eq!(decode_rgb(&mended, SIZE).expect("whole"), expected);
        assert!(matches!(complete(&mended), Ok(Cow::Borrowed(_))));
    }
}

#[test]
fn colours_survive() {
    let jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_4_4);
    let rgb = decode_rgb(&jpeg, SIZE).expect("whole");
    // Centre of a check, far from its edges.
    let pixel = &rgb[3 * (10 * SIZE.width + 17)..][..3];
    for (found, drawn) in pixel.iter().zip([200, 6 * 17, 10 * 10]) {
        assert!((i32::from(*found) - drawn).abs() < 25, "{pixel:?}");
    }
}

#[test]
fn grey_pictures_have_three_equal_channels() {
    let jpeg = without_tables(&encode(ColorType::Luma, SamplingFactor::R_4_4_4));
    let rgb = decode_rgb(&jpeg, SIZE).expect("whole");
    assert!(
        rgb.as_chunks::<3>()
            .0
            .iter()
            .all(|p| p[0] == p[1] && p[1] == p[2])
    );
    assert!(rgb.iter().max() > Some(&150) && rgb.iter().min() < Some(&80));
}

#[test]
fn another_size_is_refused_with_both() {
    let jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_2_0);
    let expected = Size {
        width: 21,
        height: 37,
    };
    assert_eq!(
        decode_rgb(&jpeg, expected),
        Err(JpegError::Size {
            expected,
            found: SIZE
        })
    );
}

/// Images in every supported coding: sampling, restart markers, several scans.
fn codings() -> Vec<Vec<u8>> {
    let mut pictures = Vec::new();
    for sampling in [
        SamplingFactor::R_4_4_4,
        SamplingFactor::R_4_2_2,
        SamplingFactor::R_4_2_0,
    ] {
        for (restart, progressive) in [
            (None, None),
            (Some(2), None),
            (None, Some(4)),
            (None, Some(9)),
        ] {
            pictures.push(encode_with(ColorType::Rgb, sampling, |encoder| {
                if let Some(interval) = restart {
                    encoder.set_restart_interval(interval);
                }
                if let Some(scans) = progressive {
                    encoder.set_progressive_scans(scans);
                }
            }));
        }
    }
    pictures.push(encode(ColorType::Luma, SamplingFactor::R_4_4_4));
    pictures
}

#[test]
fn every_cut_is_refused_with_and_without_end_marker() {
    for jpeg in codings() {
        let whole = decode_rgb(&jpeg, SIZE).expect("whole");
        let end = jpeg.len() - 2;
        for length in 0..end {
            let cut = &jpeg[..length];
            assert!(decode_rgb(cut, SIZE).is_err(), "{length} of {end} bytes");
            let marked = [cut, &[0xff, END_OF_IMAGE]].concat();
            assert!(
                decode_rgb(&marked, SIZE).is_err(),
                "{length} of {end} bytes, marked"
            );
            let padded = [cut, &[0; 400]].concat();
            assert!(
                decode_rgb(&padded, SIZE).is_err(),
                "{length} of {end} bytes, padded"
            );
        }
        for length in [end, end + 1] {
            assert_eq!(decode_rgb(&jpeg[..length], SIZE), Ok(whole.clone()));
            let padded = [&jpeg[..length], &[0; 400]].concat();
            assert_eq!(decode_rgb(&padded, SIZE), Ok(whole.clone()));
        }
        let two = [&jpeg[..end], &jpeg].concat();
        assert_eq!(decode_rgb(&two, SIZE), Ok(whole));
    }
}

#[test]
fn a_missing_end_marker_is_put_back_for_others() {
    let jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_2_0);
    let open = without_tables(&jpeg[..jpeg.len() - 2]);
    let mended = complete(&open).expect("whole");
    assert!(mended.ends_with(&[0xff, END_OF_IMAGE]));
    assert_eq!(decode_rgb(&mended, SIZE), decode_rgb(&jpeg, SIZE));
}

/// Positions of the restart markers.
fn restart_markers(jpeg: &[u8]) -> Vec<usize> {
    let is_one = |&at: &usize| jpeg[at] == 0xff && (0xd0..=0xd7).contains(&jpeg[at + 1]);
    (600..jpeg.len() - 1).filter(is_one).collect()
}

#[test]
fn fill_and_stray_bytes_before_restart_markers_change_nothing() {
    for jpeg in codings() {
        let whole = decode_rgb(&jpeg, SIZE).expect("whole");
        for junk in [
            &[0xff][..],
            &[0xff; 5],
            &[0x07, 0x5a, 0x13],
            &[0x07, 0xff, 0x00, 0xff],
        ] {
            let mut changed = Vec::new();
            let mut from = 0;
            for at in restart_markers(&jpeg) {
                changed.extend(&jpeg[from..at]);
                changed.extend(junk);
                from = at;
            }
            changed.extend(&jpeg[from..jpeg.len() - 2]);
            changed.extend(junk);
            changed.extend([0xff, END_OF_IMAGE]);
            assert_eq!(decode_rgb(&changed, SIZE), Ok(whole.clone()), "{junk:?}");
            let mended = complete(&changed).expect("whole");
            assert_eq!(decode_rgb(&mended, SIZE), Ok(whole.clone()), "{junk:?}");
        }
    }
}

#[test]
fn a_picture_that_lost_its_middle_is_refused() {
    let jpeg = encode_with(ColorType::Rgb, SamplingFactor::R_4_2_0, |encoder| {
        encoder.set_restart_interval(1);
    });
    let markers = restart_markers(&jpeg);
    assert!(markers.len() > 3);
    let lost = [&jpeg[..markers[1]], &jpeg[markers[2]..]].concat();
    let error = decode_rgb(&lost, SIZE).expect_err("an interval lacks");
    assert!(error.to_string().contains("restart marker"), "{error}");
}

#[test]
fn a_header_may_not_claim_everything() {
    let mut jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_2_0);
    let header = (0..)
        .find(|&at| jpeg[at..at + 2] == [0xff, 0xc0])
        .expect("a frame header");
    for (height, width) in [(65_535, 65_535), (1, 65_535), (16_384, 16_384), (0, 16)] {
        jpeg[header + 5..header + 7].copy_from_slice(&u16::to_be_bytes(height));
        jpeg[header + 7..header + 9].copy_from_slice(&u16::to_be_bytes(width));
        let claimed = Size {
            width: width.into(),
            height: height.into(),
        };
        assert_eq!(size(&jpeg), Err(JpegError::TooLarge { claimed }));
    }
    // A possible size is rejected too if the data for that many pixels are missing.
    jpeg[header + 5..header + 9].copy_from_slice(&[0x1f, 0xf0, 0x1f, 0xf0]);
    assert!(matches!(size(&jpeg), Err(JpegError::Truncated { .. })));
}

#[test]
fn padding_behind_the_picture_is_ignored() {
    let jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_2_2);
    let padded = [&jpeg[..], &[0; 1000]].concat();
    assert_eq!(decode_rgb(&padded, SIZE), decode_rgb(&jpeg, SIZE));
    assert_eq!(complete(&padded).expect("whole").as_ref(), jpeg);
}

#[test]
fn other_files_are_named_as_such() {
    assert!(matches!(
        decode_rgb(b"\x89PNG", SIZE),
        Err(JpegError::NotJpeg { at: 0, length: 4 })
    ));
    assert_eq!(size(&[0xff, 0xd8, 0xff, 0xd9]), Err(JpegError::Empty));
}

proptest! {
    #[test]
    fn damage_is_an_error_or_a_picture(
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        strip: bool,
    ) {
        let mut jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_2_0);
        if strip {
            jpeg = without_tables(&jpeg);
        }
        for (at, byte) in damage {
            let at = at.index(jpeg.len());
            jpeg[at] = byte;
        }
        if let Ok(rgb) = decode_rgb(&jpeg, SIZE) {
            prop_assert_eq!(rgb.len(), 3 * SIZE.area());
        }
    }
}
