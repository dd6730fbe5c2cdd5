//! Cameras that do not look straight down, and wide lenses.

use imgproc::Size;

/// Focal length relative to the width of the picture: 53 degrees.
const FOCAL_WIDTHS: f32 = 1.0;

/// A camera above the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Viewpoint {
    /// Angle between its axis and the floor's normal.
    pub(crate) tilt_rad: f32,
    /// Direction in the picture in which the floor is farther away.
    pub(crate) away_rad: f32,
    /// Radial distortion of its lens (Brown and Conrady), relative to the focal length.
    pub(crate) k1: f32,
}

impl Viewpoint {
    /// Straight down, through a perfect lens.
    pub(crate) const ABOVE: Self = Self {
        tilt_rad: 0.0,
        away_rad: 0.0,
        k1: 0.0,
    };

    /// The point of the floor that a pixel shows. In the middle of the picture of an upright
    /// camera, a unit of the floor is a pixel.
    pub(crate) fn to_floor(self, pixel: [f32; 2], size: Size) -> [f32; 2] {
        if self == Self::ABOVE {
            return pixel;
        }
        let focal = FOCAL_WIDTHS * size.width as f32;
        let [x, y] = [
            (pixel[0] - size.width as f32 / 2.0) / focal,
            (pixel[1] - size.height as f32 / 2.0) / focal,
        ];
        // Undo the lens: radius = undistorted (1 + k1 undistorted²).
        let radius = x.hypot(y);
        let mut undistorted = radius;
        for _ in 0..6 {
            let square = undistorted * undistorted;
            let off = undistorted * (1.0 + self.k1 * square) - radius;
            undistorted -= off / (1.0 + 3.0 * self.k1 * square);
        }
        let grown = if radius > 0.0 {
            undistorted / radius
        } else {
            1.0
        };
        // Along the direction away from the camera, and across it.
        let (sin, cos) = self.away_rad.sin_cos();
        let (along, across) = (grown * (cos * x + sin * y), grown * (cos * y - sin * x));
        // The ray (along, across, 1) meets the floor, which falls away along `along`.
        let (sin_tilt, cos_tilt) = self.tilt_rad.sin_cos();
        let depth = cos_tilt / (cos_tilt - sin_tilt * along);
        let (along, across) = (focal * depth * along / cos_tilt, focal * depth * across);
        [cos * along - sin * across, sin * along + cos * across]
    }

    /// Derivatives of the floor's x with respect to the pixel's x and y, and of its y.
    fn slopes(&self, [x, y]: [f32; 2], size: Size) -> [[f32; 2]; 2] {
        const STEP: f32 = 2.0;
        let between = |a: [f32; 2], b: [f32; 2]| {
            let (a, b) = (self.to_floor(a, size), self.to_floor(b, size));
            [0, 1].map(|i| (b[i] - a[i]) / (2.0 * STEP))
        };
        let [xx, yx] = between([x - STEP, y], [x + STEP, y]);
        let [xy, yy] = between([x, y - STEP], [x, y + STEP]);
        [[xx, xy], [yx, yy]]
    }

    /// Units of the floor per pixel: the square root of the ratio of their areas.
    pub(crate) fn floor_per_px(&self, pixel: [f32; 2], size: Size) -> f32 {
        let [[a, b], [c, d]] = self.slopes(pixel, size);
        (a * d - b * c).sqrt()
    }

    /// Direction in the picture of a direction on the floor.
    pub(crate) fn heading_in_picture(&self, pixel: [f32; 2], heading_rad: f32, size: Size) -> f32 {
        let [[a, b], [c, d]] = self.slopes(pixel, size);
        let (sin, cos) = heading_rad.sin_cos();
        (a * sin - c * cos).atan2(d * cos - b * sin)
    }
}

#[test]
fn a_tilted_camera_sees_the_far_floor_compressed() {
    let size = Size {
        width: 640,
        height: 480,
    };
    let tilted = Viewpoint {
        tilt_rad: 0.5,
        ..Viewpoint::ABOVE
    };
    // In the middle: 1 / cos along the tilt and 1 across it.
    let [[xx, xy], [yx, yy]] = tilted.slopes([320.0, 240.0], size);
    assert!((xx - 1.0 / 0.5f32.cos()).abs() < 0.01 && (yy - 1.0).abs() < 0.01);
    assert!(xy.abs() + yx.abs() < 0.01);
    assert!(tilted.floor_per_px([600.0, 240.0], size) > 1.5);
    assert!(tilted.floor_per_px([40.0, 240.0], size) < 1.0);
    // Straight lines stay straight without a lens' distortion, and bend with it.
    let collinear = |viewpoint: Viewpoint| {
        let [a, b, c] = [100.0, 300.0, 500.0].map(|x| viewpoint.to_floor([x, 90.0], size));
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    assert!(collinear(tilted).abs() < 5.0);
    assert!(collinear(Viewpoint { k1: -0.2, ..tilted }).abs() > 500.0);
}
