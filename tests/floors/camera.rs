//! From a canvas under a light to the bytes of a frame.

use std::sync::LazyLock;

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use overcam::frame::{Frame, PixelFormat};

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
    /// Standard deviation at a grey value of 128. Half of the variance there is that of arriving light.
    noise_sigma: f32,
    encoding: Encoding,
    /// Rows exposed so far: each has its own noise.
    rows: u64,
    /// A row without noise.
    lit: Vec<f32>,
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
        for (y, (row, out)) in rows.zip(out).enumerate() {
            self.rows += 1;
            let noise = &NOISE[mixed(self.rows) as usize % (NOISE.len() - 3 * size.width)..];
            let relative_y = y as f32 / size.height as f32;
            self.lit.clear();
            for (x, colour) in row.iter().enumerate() {
                let field = light.field(x as f32 / size.width as f32, relative_y);
                let [r, g, b] = light.gain;
                let lit = [
                    colour[0] * r * field,
                    colour[1] * g * field,
                    colour[2] * b * field,
                ];
                self.lit.extend(match self.encoding {
                    Encoding::Grey => [luma(lit); 3],
                    _ => lit,
                });
            }
            for ((out, lit), noise) in out.iter_mut().zip(&self.lit).zip(noise) {
                let lit = lit.min(255.0);
                let sigma = self.noise_sigma * (0.5 + lit / 256.0).sqrt();
                *out = (lit + sigma * noise + 0.5).clamp(0.0, 255.0) as i32 as u8;
            }
        }
        frame.size = size;
        frame.full_range = true;
        self.encode(frame);
    }

    fn encode(&self, frame: &mut Frame) {
        let (width, height) = (frame.size.width, frame.size.height);
        frame.bytes.clear();
        let pixels = self.rgb.as_chunks::<3>().0;
        let yuv = |x: usize, y: usize| yuv(pixels[y * width + x].map(f32::from));
        match self.encoding {
            Encoding::Rgb => {
                frame.format = PixelFormat::Rgb;
                frame.bytes.extend_from_slice(&self.rgb);
            }
            Encoding::Grey => {
                frame.format = PixelFormat::Grey;
                // The three are alike but for their noise.
                frame.bytes.extend(pixels.iter().map(|pixel| pixel[0]));
            }
            Encoding::I420 => {
                frame.format = PixelFormat::I420;
                let all = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
                frame
                    .bytes
                    .extend(all.map(|(x, y)| yuv(x, y)[0].round() as u8));
                for channel in [1, 2] {
                    for y in (0..height).step_by(2) {
                        for x in (0..width).step_by(2) {
                            let sum: f32 = [(0, 0), (1, 0), (0, 1), (1, 1)]
                                .map(|(dx, dy)| {
                                    yuv((x + dx).min(width - 1), (y + dy).min(height - 1))[channel]
                                })
                                .iter()
                                .sum();
                            frame.bytes.push((sum / 4.0).round() as u8);
                        }
                    }
                }
            }
            Encoding::Yuyv => {
                frame.format = PixelFormat::Yuyv;
                for y in 0..height {
                    for x in (0..width).step_by(2) {
                        let (left, right) = (yuv(x, y), yuv((x + 1).min(width - 1), y));
                        let chroma = |i: usize| (left[i] + right[i]) / 2.0;
                        let pair = [left[0], chroma(1), right[0], chroma(2)];
                        frame.bytes.extend(pair.map(|value| value.round() as u8));
                    }
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

fn yuv(rgb: [f32; 3]) -> [f32; 3] {
    let y = luma(rgb);
    [
        y,
        128.0 + 0.564 * (rgb[2] - y),
        128.0 + 0.713 * (rgb[0] - y),
    ]
}
