//! Layout of the pixels in a driver's buffer, whose rows may be padded.

use std::iter;
use std::ops::Range;

use imgproc::Size;

use crate::image::frame::PixelFormat;

/// Byte ranges of the pixels in a buffer with a stride of `bytes_per_line` (0: without padding):
/// one range per row, or a single one if there is no padding, in the order of [`PixelFormat`]. No
/// ranges for JPEG. `None` if rows overlap.
pub(super) fn rows(
    format: PixelFormat,
    size: Size,
    bytes_per_line: usize,
) -> Option<Vec<Range<usize>>> {
    let Size { width, height } = size;
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    // For each plane: bytes per row, number of rows, and the divisor of the stride of the first
    // plane.
    let planes: &[(usize, usize, usize)] = match format {
        PixelFormat::Grey => &[(width, height, 1)],
        PixelFormat::Rgb => &[(3 * width, height, 1)],
        PixelFormat::Yuyv | PixelFormat::Uyvy => &[(4 * half_width, height, 1)],
        PixelFormat::Nv12 => &[(width, height, 1), (2 * half_width, half_height, 1)],
        PixelFormat::I420 => {
            let chroma = (half_width, half_height, 2);
            &[(width, height, 1), chroma, chroma]
        }
        PixelFormat::I422 => {
            let chroma = (half_width, height, 2);
            &[(width, height, 1), chroma, chroma]
        }
        PixelFormat::I444 => &[(width, height, 1), (width, height, 1), (width, height, 1)],
        PixelFormat::Jpeg => return Some(Vec::new()),
    };
    let is_padded = |&(row_bytes, _, part): &(usize, usize, usize)| {
        bytes_per_line != 0 && bytes_per_line / part != row_bytes
    };
    if !planes.iter().any(is_padded) {
        return format
            .frame_bytes(size)
            .map(|bytes| iter::once(0..bytes).collect());
    }
    let mut rows = Vec::new();
    let mut start = 0;
    for &(row_bytes, n_rows, part) in planes {
        let distance = bytes_per_line / part;
        if distance < row_bytes {
            return None;
        }
        rows.extend(
            (0..n_rows).map(|row| start + row * distance..start + row * distance + row_bytes),
        );
        start += n_rows * distance;
    }
    Some(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn size(width: usize, height: usize) -> Size {
        Size { width, height }
    }

    #[test]
    fn padding_is_left_out() {
        // 4x2 pixels, stride 6 bytes.
        assert_eq!(
            rows(PixelFormat::Grey, size(4, 2), 6),
            Some(vec![0..4, 6..10])
        );
        assert_eq!(
            rows(PixelFormat::Nv12, size(4, 2), 6),
            Some(vec![0..4, 6..10, 12..16])
        );
        assert_eq!(
            rows(PixelFormat::I420, size(4, 2), 8),
            Some(vec![0..4, 8..12, 16..18, 20..22])
        );
        assert_eq!(
            rows(PixelFormat::Yuyv, size(2, 2), 8),
            Some(vec![0..4, 8..12])
        );
    }

    #[test]
    fn rows_without_padding_are_one_piece() {
        for (format, _, bytes_per_line) in [
            (PixelFormat::Grey, 1, 4),
            (PixelFormat::Rgb, 3, 12),
            (PixelFormat::Uyvy, 2, 8),
            (PixelFormat::Nv12, 1, 4),
            (PixelFormat::I420, 1, 4),
            (PixelFormat::I422, 1, 4),
            (PixelFormat::I444, 1, 0),
        ] {
            let bytes = format.frame_bytes(size(4, 2)).expect("raw");
            assert_eq!(
                rows(format, size(4, 2), bytes_per_line),
                Some(iter::once(0..bytes).collect())
            );
        }
        assert_eq!(rows(PixelFormat::Jpeg, size(4, 2), 0), Some(vec![]));
    }

    #[test]
    fn the_rows_hold_a_whole_frame_whatever_the_padding() {
        for (format, bytes_a_pixel) in [
            (PixelFormat::Grey, 1),
            (PixelFormat::Rgb, 3),
            (PixelFormat::Yuyv, 2),
            (PixelFormat::Nv12, 1),
            (PixelFormat::I420, 1),
        ] {
            for padding in [0, 2, 64] {
                let rows = rows(format, size(6, 5), 6 * bytes_a_pixel + padding).expect("possible");
                let bytes = rows.iter().map(ExactSizeIterator::len).sum();
                assert_eq!(format.frame_bytes(size(6, 5)), Some(bytes), "{format:?}");
                assert!(rows.is_sorted_by(|a, b| a.end <= b.start));
            }
        }
    }

    #[test]
    fn overlapping_rows_are_refused() {
        assert_eq!(rows(PixelFormat::Rgb, size(4, 2), 11), None);
        assert_eq!(rows(PixelFormat::Yuyv, size(5, 2), 10), None);
    }
}
