//! From a canvas under a light to the bytes of a frame.

use std::sync::LazyLock;

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use overcam::image::frame::{Frame, PixelFormat};

use crate::canvas::Canvas;
use crate::light::Light;
use crate::random::{mixed, normal};

/// How the pixels leave the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Encoding {
    Rgb,
    Grey,
    /// 4:2:0.
    I420,
    /// 4:2:2.
    Yuyv,
    /// 4:2:0 in JPEG of a quality.
    Jpeg(u8),
}

/// A sensor and its encoder.
#[derive(Debug)]
pub(crate) struct Camera {
    /// Standard deviation at a grey value of 128. Half of the variance there is that of arriving
    /// light.
    noise_sigma: f32,
    encoding: Encoding,
    /// Rows exposed so far: each has its own noise.
    rows: u64,
    /// A row without noise.
    lit: Vec<[f32; 3]>,
    rgb: Vec<u8>,
}

/// Every row of every frame takes its noise from another place of this.
static NOISE: LazyLock<Vec<f32>> = LazyLock::new(|| normal(1 << 18));

impl Camera {
    pub(crate) fn new(noise_sigma: f32, encoding: Encoding) -> Self {
        Self {
            noise_sigma,
            encoding,
            rows: 0,
            lit: Vec::new(),
            rgb: Vec::new(),
        }
    }

    /// A picture without noise and coding.
    pub(crate) fn ideal() -> Self {
        Self::new(0.0, Encoding::Rgb)
    }

    /// Fills the frame with what the canvas looks like.
    pub(crate) fn expose(&mut self, canvas: &Canvas, light: &Light, frame: &mut Frame) {
        let size = canvas.size;
        self.rgb.resize(3 * size.area(), 0);
        let rows = canvas.pixels.chunks_exact(size.width);
        let out = self.rgb.chunks_exact_mut(3 * size.width);
        self.lit.resize(size.width, [0.0; 3]);
        for (y, (row, out)) in rows.zip(out).enumerate() {
            self.rows += 1;
            let noise = &NOISE[mixed(self.rows) as usize % (NOISE.len() - 3 * size.width)..];
            light.fall_on(row, y as f32 / size.height as f32, &mut self.lit);
            if self.encoding == Encoding::Grey {
                for lit in &mut self.lit {
                    *lit = [luma(*lit); 3];
                }
            }
            let lit = self.lit.as_flattened();
            for ((out, lit), noise) in out.iter_mut().zip(lit).zip(noise) {
                let lit = lit.min(255.0);
                // Within 3 % the square root of (1 + lit / 128) / 2.
                let sigma = self.noise_sigma * (0.73 + 0.002 * lit);
                // A plain cast is not vectorised: the sum has the nearest whole number in its
                // lowest bits.
                let whole = (lit + sigma * noise).clamp(0.0, 255.0) + (1 << 23) as f32;
                *out = whole.to_bits() as u8;
            }
        }
        frame.size = size;
        frame.full_range = true;
        self.encode(frame);
    }

    /// Sides of the pictures are even.
    fn encode(&self, frame: &mut Frame) {
        let (width, height) = (frame.size.width, frame.size.height);
        frame.bytes.clear();
        let pixels = self.rgb.as_chunks::<3>().0;
        match self.encoding {
            Encoding::Rgb => {
                frame.format = PixelFormat::Rgb;
                frame.bytes.extend_from_slice(&self.rgb);
            }
            Encoding::Grey => {
                // The three are alike but for their noise.
                frame.format = PixelFormat::Grey;
                frame.bytes.extend(pixels.iter().map(|pixel| pixel[0]));
            }
            Encoding::I420 => {
                frame.format = PixelFormat::I420;
                let yuv: Vec<_> = pixels.iter().map(|&pixel| yuv(pixel)).collect();
                frame.bytes.extend(yuv.iter().map(|yuv| yuv[0] as u8));
                for channel in [1, 2] {
                    for rows in yuv.chunks_exact(2 * width) {
                        let (upper, lower) = rows.split_at(width);
                        let columns = upper.as_chunks::<2>().0.iter();
                        let mean = |(a, b): (&[[f32; 3]; 2], &[[f32; 3]; 2])| {
                            (a[0][channel] + a[1][channel] + b[0][channel] + b[1][channel]) / 4.0
                        };
                        let columns = columns.zip(lower.as_chunks::<2>().0);
                        frame.bytes.extend(columns.map(|square| mean(square) as u8));
                    }
                }
            }
            Encoding::Yuyv => {
                frame.format = PixelFormat::Yuyv;
                for pair in pixels.as_chunks::<2>().0 {
                    let [left, right] = pair.map(yuv);
                    let chroma = |i: usize| (left[i] + right[i]) / 2.0;
                    let pair = [left[0], chroma(1), right[0], chroma(2)];
                    frame.bytes.extend(pair.map(|value| value as u8));
                }
            }
            Encoding::Jpeg(quality) => {
                frame.format = PixelFormat::Jpeg;
                let mut encoder = Encoder::new(&mut frame.bytes, quality);
                encoder.set_sampling_factor(SamplingFactor::R_4_2_0);
                encoder
                    .encode(&self.rgb, width as u16, height as u16, ColorType::Rgb)
                    .expect("a picture of few pixels is encoded");
            }
        }
    }
}

/// BT.601.
pub(crate) fn luma([r, g, b]: [f32; 3]) -> f32 {
    0.299 * r + 0.587 * g + 0.114 * b
}

/// Luma and chroma in the full range, with the half that makes a cast round.
fn yuv(rgb: [u8; 3]) -> [f32; 3] {
    let [r, g, b] = rgb.map(f32::from);
    let y = luma([r, g, b]);
    [y + 0.5, 128.5 + 0.564 * (b - y), 128.5 + 0.713 * (r - y)]
}

#[cfg(test)]
mod tests {
    use imgproc::Size;
    use overcam::image::frame::{Picture, decode};

    use super::*;
    use crate::floor::Floor;

    const SIZE: Size = Size {
        width: 64,
        height: 48,
    };

    fn exposed(floor: Floor, camera: &mut Camera) -> Picture {
        let (mut frame, mut picture) = (Frame::empty(), Picture::new(SIZE));
        camera.expose(&Canvas::new(floor, SIZE), &Light::EVEN, &mut frame);
        decode(&frame, &mut picture).expect("a drawn frame decodes");
        picture
    }

    #[test]
    fn every_encoding_shows_the_same_colour() {
        for encoding in [
            Encoding::Rgb,
            Encoding::I420,
            Encoding::Yuyv,
            Encoding::Jpeg(80),
        ] {
            let picture = exposed(Floor::Lino, &mut Camera::new(0.0, encoding));
            for (plane, expected) in [(picture.red, 92), (picture.green, 128), (picture.blue, 108)]
            {
                for value in plane {
                    assert!(
                        value.abs_diff(expected) <= 3,
                        "{encoding:?}: {value}, not {expected}"
                    );
                }
            }
        }
        let grey = exposed(Floor::Lino, &mut Camera::new(0.0, Encoding::Grey));
        assert!(grey.red.iter().all(|value| value.abs_diff(115) <= 1));
    }

    #[test]
    fn noise_is_as_strong_as_stated() {
        for encoding in [Encoding::Rgb, Encoding::Grey] {
            let mut camera = Camera::new(6.0, encoding);
            let picture = exposed(Floor::Grey, &mut camera);
            let square = |value: &u8| (f64::from(*value) - 120.0).powi(2);
            let variance = picture.red.iter().map(square).sum::<f64>() / SIZE.area() as f64;
            let expected = 36.0 * (0.5 + 120.0 / 256.0);
            assert!(
                (variance / expected - 1.0).abs() < 0.1,
                "{variance}, not {expected}"
            );
            let again = exposed(Floor::Grey, &mut camera);
            assert_ne!(picture.red, again.red);
        }
    }
}
