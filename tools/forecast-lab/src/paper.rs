//! The neural network of the paper, implemented literally.

use crate::classical::Predictor;
use crate::random::Random;

/// The paper's network (section 3.1.2): it maps the last four positions to the next one, is trained
/// in every frame by twenty passes of backpropagation over all samples, and is fed its own output
/// to predict several steps.
pub struct PaperNetwork {
    step_s: f64,
    positions: Vec<[f64; 2]>,
    hidden: Vec<Vec<f64>>,
    output: Vec<Vec<f64>>,
    span: [f64; 2],
    start: [f64; 2],
}

const PAPER_INPUTS: usize = 4;
const PAPER_HIDDEN: usize = 8;
const PAPER_PASSES: usize = 20;
const PAPER_SAMPLES: usize = 32;
const PAPER_RATE: f64 = 0.1;

impl PaperNetwork {
    /// `low` and `high` are the corners of the floor, to which positions are normalized.
    #[must_use]
    pub fn new(step_s: f64, low: [f64; 2], high: [f64; 2]) -> Self {
        let mut random = Random::new(1);
        let mut layer = |rows: usize, columns: usize| -> Vec<Vec<f64>> {
            (0..rows)
                .map(|_| (0..=columns).map(|_| random.between(-0.5, 0.5)).collect())
                .collect()
        };
        Self {
            step_s,
            positions: Vec::new(),
            hidden: layer(PAPER_HIDDEN, 2 * PAPER_INPUTS),
            output: layer(2, PAPER_HIDDEN),
            span: [0, 1].map(|axis| (high[axis] - low[axis]).max(1e-9)),
            start: low,
        }
    }

    fn forward(&self, window: &[[f64; 2]]) -> (Vec<f64>, [f64; 2]) {
        let inputs = window.as_flattened();
        let hidden: Vec<f64> = self
            .hidden
            .iter()
            .map(|row| {
                let sum: f64 = row.iter().zip(inputs).map(|(w, x)| w * x).sum();
                (sum + row[inputs.len()]).tanh()
            })
            .collect();
        let output = [0, 1].map(|axis| {
            let row = &self.output[axis];
            row.iter().zip(&hidden).map(|(w, x)| w * x).sum::<f64>() + row[PAPER_HIDDEN]
        });
        (hidden, output)
    }

    fn train(&mut self, window: &[[f64; 2]], target: [f64; 2]) {
        let (hidden, output) = self.forward(window);
        let error = [output[0] - target[0], output[1] - target[1]];
        for (unit, value) in hidden.iter().enumerate() {
            let back: f64 = (0..2)
                .map(|axis| error[axis] * self.output[axis][unit])
                .sum();
            let slope = PAPER_RATE * back * (1.0 - value * value);
            let row = &mut self.hidden[unit];
            for (weight, input) in row.iter_mut().zip(window.as_flattened()) {
                *weight -= slope * input;
            }
            row[2 * PAPER_INPUTS] -= slope;
        }
        for (axis, error) in error.into_iter().enumerate() {
            for (weight, value) in self.output[axis].iter_mut().zip(&hidden) {
                *weight -= PAPER_RATE * error * value;
            }
            self.output[axis][PAPER_HIDDEN] -= PAPER_RATE * error;
        }
    }
}

impl Predictor for PaperNetwork {
    fn observe(&mut self, _time_s: f64, position: [f64; 2]) {
        let position = [0, 1].map(|axis| (position[axis] - self.start[axis]) / self.span[axis]);
        if self.positions.len() == PAPER_SAMPLES {
            self.positions.remove(0);
        }
        self.positions.push(position);
        for _ in 0..PAPER_PASSES {
            for next in PAPER_INPUTS..self.positions.len() {
                let window: Vec<_> = self.positions[next - PAPER_INPUTS..next].to_vec();
                let target = self.positions[next];
                self.train(&window, target);
            }
        }
    }

    fn at(&self, ahead_s: f64) -> ([f64; 2], Option<[[f64; 2]; 2]>) {
        let Some(newest) = self.positions.last() else {
            return ([f64::NAN; 2], None);
        };
        let mut position = *newest;
        if self.positions.len() >= PAPER_INPUTS {
            let mut window = self.positions[self.positions.len() - PAPER_INPUTS..].to_vec();
            for _ in 0..(ahead_s / self.step_s).round() as usize {
                position = self.forward(&window).1;
                window.remove(0);
                window.push(position);
            }
        }
        (
            [0, 1].map(|axis| self.start[axis] + position[axis] * self.span[axis]),
            None,
        )
    }
}
