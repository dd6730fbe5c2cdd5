//! A scene as Foxglove messages: overlays on the camera image, and 3D entities on the floor.
//!
//! * [`image_annotations`]: outlines, marker names with their headings, and forecasts, drawn over
//!   the image. Foxglove measures pixels from the corner of the top left one, a scene from its
//!   centre, hence the half pixel added here. Results in metres are mapped back to the image by the
//!   inverse of the calibration.
//! * [`poses`]: recognised markers as poses, the form that other programs read most easily.
//! * [`robots`], [`obstacles`], [`forecasts`]: the same floor in three dimensions. Each message
//!   replaces all entities of its topic, so that ended tracks disappear and a jump to any point of
//!   a recording shows the state at that time.
//! * [`root_transform`]: without any transform a 3D panel stays empty. An image is flipped, because
//!   its y axis points down; a floor is not.
//!
//! Objects that were not observed in the frame but predicted have no outline: they are drawn
//! faintly, as a square of their size.
//!
//! Deliberately absent: covariances. Foxglove has no primitive for them; `--json` and the shared
//! memory contain them.

use foxglove::messages::{
    ArrowPrimitive, Color, FrameTransform, ImageAnnotations, KeyValuePair, LinePrimitive, Log,
    Point2, Point3, PointsAnnotation, Pose, PosesInFrame, Quaternion, SceneEntity,
    SceneEntityDeletion, SceneUpdate, TextAnnotation, TextPrimitive, Timestamp, Vector3,
    line_primitive, log, points_annotation::Type as Stroke, scene_entity_deletion,
};
use nalgebra::{Matrix3, Point2 as PlanePoint};
use scene::{FRAME_FLOOR, KIND_MARKER, Object, Scene};

use crate::output::foxglove::image_message::IMAGE_FRAME;

/// Coordinate frame of results in metres.
const FLOOR_FRAME: &str = "floor";
/// Root of the transform tree.
const WORLD_FRAME: &str = "world";

const ROBOT: Color = colour(0.15, 0.85, 0.35);
const OBSTACLE: Color = colour(1.0, 0.55, 0.1);
const FORECAST: Color = colour(0.3, 0.65, 1.0);
/// Opacity of objects that were not observed.
const FAINT: f64 = 0.4;

const STROKE_PX: f64 = 1.5;
const FONT_PX: f64 = 12.0;
/// Length of the arrow from a marker's centre, relative to the side of its plate.
const ARROW_LENGTH: f64 = 0.8;

const fn colour(r: f64, g: f64, b: f64) -> Color {
    Color { r, g, b, a: 1.0 }
}

/// Foxglove's name for a coordinate frame.
fn frame_id(frame: u32) -> String {
    if frame == FRAME_FLOOR {
        FLOOR_FRAME.to_owned()
    } else {
        IMAGE_FRAME.to_owned()
    }
}

/// The scene drawn over the camera image.
///
/// `image_from_floor` is for scenes in metres. Without it, a scene in metres is not drawn; neither
/// are points that it maps to infinity.
pub(crate) fn image_annotations(
    scene: &Scene,
    timestamp: Timestamp,
    image_from_floor: Option<&Matrix3<f64>>,
) -> ImageAnnotations {
    let mut annotations = ImageAnnotations {
        timestamp: Some(timestamp),
        ..ImageAnnotations::default()
    };
    let identity = Matrix3::identity();
    let image_from_scene = if scene.frame == FRAME_FLOOR {
        match image_from_floor {
            Some(matrix) => matrix,
            None => return annotations,
        }
    } else {
        &identity
    };
    let line = |stroke, points: &[[f64; 2]], colour| PointsAnnotation {
        r#type: stroke as i32,
        points: points
            .iter()
            .filter_map(|&point| image_point(point, image_from_scene))
            .collect(),
        outline_color: Some(colour),
        thickness: STROKE_PX,
        ..PointsAnnotation::default()
    };
    for object in scene.objects() {
        let colour = object_colour(object);
        annotations
            .points
            .push(line(Stroke::LineLoop, &outline(object), colour));
        if let Some(heading_rad) = object.heading() {
            let arrow = arrow_segments(object, heading_rad);
            annotations
                .points
                .push(line(Stroke::LineList, &arrow, colour));
        }
        if !object.forecast().is_empty() {
            annotations.points.push(line(
                Stroke::LineStrip,
                &forecast_path(object),
                faded(FORECAST, object),
            ));
        }
        let position = image_point([object.x, object.y], image_from_scene);
        if let (Some(name), Some(position)) = (object.marker_name(), position) {
            annotations.texts.push(TextAnnotation {
                position: Some(position),
                text: name.to_owned(),
                font_size: FONT_PX,
                text_color: Some(colour),
                ..TextAnnotation::default()
            });
        }
    }
    annotations
}

/// The markers read in this frame, in the order of their tracks. The pose of an unknown heading has
/// the identity rotation.
pub(crate) fn poses(scene: &Scene, timestamp: Timestamp) -> PosesInFrame {
    let seen = |object: &&Object| object.kind == KIND_MARKER && object.observed();
    PosesInFrame {
        timestamp: Some(timestamp),
        frame_id: frame_id(scene.frame),
        poses: scene.objects().iter().filter(seen).map(pose).collect(),
    }
}

/// Marked robots and targets: outline, arrow and name.
pub(crate) fn robots(scene: &Scene, timestamp: Timestamp) -> SceneUpdate {
    update(scene, timestamp, |object| {
        let name = object.marker_name()?;
        Some(SceneEntity {
            lines: vec![outline_line(object)],
            arrows: vec![ArrowPrimitive {
                pose: Some(pose(object)),
                shaft_length: 0.7 * ARROW_LENGTH * object.size,
                shaft_diameter: 0.08 * object.size,
                head_length: 0.3 * ARROW_LENGTH * object.size,
                head_diameter: 0.2 * object.size,
                color: Some(object_colour(object)),
            }],
            texts: vec![TextPrimitive {
                pose: Some(pose(object)),
                billboard: true,
                font_size: FONT_PX,
                scale_invariant: true,
                color: Some(object_colour(object)),
                text: name.to_owned(),
            }],
            metadata: vec![KeyValuePair {
                key: "marker".to_owned(),
                value: name.to_owned(),
            }],
            ..SceneEntity::default()
        })
    })
}

/// Objects without a recognised marker: outlines.
pub(crate) fn obstacles(scene: &Scene, timestamp: Timestamp) -> SceneUpdate {
    update(scene, timestamp, |object| {
        if object.kind == KIND_MARKER {
            return None;
        }
        Some(SceneEntity {
            lines: vec![outline_line(object)],
            ..SceneEntity::default()
        })
    })
}

/// The predicted path of each object.
pub(crate) fn forecasts(scene: &Scene, timestamp: Timestamp) -> SceneUpdate {
    update(scene, timestamp, |object| {
        if object.forecast().is_empty() {
            return None;
        }
        Some(SceneEntity {
            lines: vec![floor_line(
                line_primitive::Type::LineStrip,
                &forecast_path(object),
                faded(FORECAST, object),
            )],
            ..SceneEntity::default()
        })
    })
}

/// Connects the coordinate frame of the results, [`FRAME_IMAGE`](scene::FRAME_IMAGE) or
/// [`FRAME_FLOOR`], to the root.
pub(crate) fn root_transform(frame: u32, timestamp: Timestamp) -> FrameTransform {
    let half_turn_about_x = Quaternion {
        x: 1.0,
        y: 0.0,
        z: 0.0,
        w: 0.0,
    };
    FrameTransform {
        timestamp: Some(timestamp),
        parent_frame_id: WORLD_FRAME.to_owned(),
        child_frame_id: frame_id(frame),
        translation: Some(Vector3::default()),
        rotation: Some(if frame == FRAME_FLOOR {
            quaternion(0.0)
        } else {
            half_turn_about_x
        }),
    }
}

/// A message for the log panel.
pub(crate) fn warning(message: String, timestamp: Timestamp) -> Log {
    Log {
        timestamp: Some(timestamp),
        level: log::Level::Warning as i32,
        message,
        name: "overcam".to_owned(),
        ..Log::default()
    }
}

/// One entity for each object for which `draw` returns one; all older ones on the topic are
/// removed.
fn update(
    scene: &Scene,
    timestamp: Timestamp,
    draw: impl Fn(&Object) -> Option<SceneEntity>,
) -> SceneUpdate {
    let entities = scene.objects().iter().filter_map(|object| {
        let mut entity = draw(object)?;
        entity.timestamp = Some(timestamp);
        entity.frame_id = frame_id(scene.frame);
        entity.id = format!("track {}", object.track);
        Some(entity)
    });
    SceneUpdate {
        deletions: vec![SceneEntityDeletion {
            timestamp: Some(timestamp),
            r#type: scene_entity_deletion::Type::All as i32,
            id: String::new(),
        }],
        entities: entities.collect(),
    }
}

fn outline_line(object: &Object) -> LinePrimitive {
    floor_line(
        line_primitive::Type::LineLoop,
        &outline(object),
        object_colour(object),
    )
}

fn floor_line(kind: line_primitive::Type, points: &[[f64; 2]], colour: Color) -> LinePrimitive {
    LinePrimitive {
        r#type: kind as i32,
        pose: Some(Pose {
            position: Some(Vector3::default()),
            orientation: Some(quaternion(0.0)),
        }),
        thickness: STROKE_PX,
        scale_invariant: true,
        points: points
            .iter()
            .map(|&[x, y]| Point3 { x, y, z: 0.0 })
            .collect(),
        color: Some(colour),
        ..LinePrimitive::default()
    }
}

fn pose(object: &Object) -> Pose {
    Pose {
        position: Some(Vector3 {
            x: object.x,
            y: object.y,
            z: 0.0,
        }),
        orientation: Some(quaternion(object.heading().unwrap_or(0.0))),
    }
}

/// Rotation about z. In the image z points into the picture, so a heading from +x towards +y is
/// positive there too.
fn quaternion(heading_rad: f64) -> Quaternion {
    let (z, w) = (heading_rad / 2.0).sin_cos();
    Quaternion {
        x: 0.0,
        y: 0.0,
        z,
        w,
    }
}

/// The object's outline, or a square of its size if it was not observed.
fn outline(object: &Object) -> Vec<[f64; 2]> {
    if !object.outline().is_empty() {
        return object.outline().to_vec();
    }
    let (sin, cos) = object.heading().unwrap_or(0.0).sin_cos();
    let half = object.size / 2.0;
    [(half, half), (-half, half), (-half, -half), (half, -half)]
        .map(|(u, v)| [object.x + cos * u - sin * v, object.y + sin * u + cos * v])
        .to_vec()
}

/// An arrow as pairs of points: shaft and two barbs.
fn arrow_segments(object: &Object, heading_rad: f64) -> [[f64; 2]; 6] {
    let length = ARROW_LENGTH * object.size;
    let ahead = |[x, y]: [f64; 2], angle_rad: f64, distance: f64| {
        let (sin, cos) = angle_rad.sin_cos();
        [x + distance * cos, y + distance * sin]
    };
    let centre = [object.x, object.y];
    let tip = ahead(centre, heading_rad, length);
    let barb = |turn_rad: f64| ahead(tip, heading_rad + turn_rad, -0.3 * length);
    [centre, tip, tip, barb(0.5), tip, barb(-0.5)]
}

/// The current and predicted positions of an object.
fn forecast_path(object: &Object) -> Vec<[f64; 2]> {
    let ahead = object.forecast().iter().map(|point| [point.x, point.y]);
    std::iter::once([object.x, object.y]).chain(ahead).collect()
}

/// A point of the scene in Foxglove's pixel coordinates; `None` if the homography maps it to
/// infinity.
fn image_point([x, y]: [f64; 2], image_from_scene: &Matrix3<f64>) -> Option<Point2> {
    let point =
        PlanePoint::from_homogeneous(image_from_scene * PlanePoint::new(x, y).to_homogeneous())?;
    let point = Point2 {
        x: point.x + 0.5,
        y: point.y + 0.5,
    };
    (point.x.is_finite() && point.y.is_finite()).then_some(point)
}

fn object_colour(object: &Object) -> Color {
    let colour = if object.kind == KIND_MARKER {
        ROBOT
    } else {
        OBSTACLE
    };
    faded(colour, object)
}

fn faded(colour: Color, object: &Object) -> Color {
    let a = if object.observed() { 1.0 } else { FAINT };
    Color { a, ..colour }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{FRAME_IMAGE, ForecastPoint, HAS_HEADING, KIND_OBSTACLE, OBSERVED};

    fn now() -> Timestamp {
        Timestamp::new(12, 500)
    }

    /// A robot at (10, 20) facing +y, and a predicted obstacle at (-3, 4).
    fn example(frame: u32) -> Scene {
        let mut scene = Scene::EMPTY;
        scene.frame = frame;
        scene.n_objects = 2;
        let robot = &mut scene.objects[0];
        robot.track = 7;
        (robot.x, robot.y, robot.size) = (10.0, 20.0, 5.0);
        robot.heading_rad = std::f64::consts::FRAC_PI_2;
        robot.kind = KIND_MARKER;
        robot.flags = OBSERVED | HAS_HEADING;
        robot.marker[..5].copy_from_slice(b"arrow");
        robot.n_outline = 3;
        robot.outline[..3].copy_from_slice(&[[8.0, 18.0], [12.0, 18.0], [10.0, 23.0]]);
        robot.n_forecast = 1;
        robot.forecast[0] = ForecastPoint {
            dt_s: 0.1,
            x: 10.0,
            y: 25.0,
            ..ForecastPoint::EMPTY
        };
        let obstacle = &mut scene.objects[1];
        obstacle.track = 9;
        (obstacle.x, obstacle.y, obstacle.size) = (-3.0, 4.0, 2.0);
        obstacle.kind = KIND_OBSTACLE;
        scene
    }

    fn points(annotation: &PointsAnnotation) -> Vec<[f64; 2]> {
        annotation.points.iter().map(|p| [p.x, p.y]).collect()
    }

    fn assert_near(found: &[[f64; 2]], expected: &[[f64; 2]]) {
        assert_eq!(found.len(), expected.len(), "{found:?}");
        for (found, expected) in found.as_flattened().iter().zip(expected.as_flattened()) {
            assert!((found - expected).abs() < 1e-9, "{found} is not {expected}");
        }
    }

    #[test]
    fn annotations_count_from_the_corner_of_the_first_pixel() {
        let annotations = image_annotations(&example(FRAME_IMAGE), now(), None);
        let [outline, arrow, forecast, square] = &annotations.points[..] else {
            panic!("{annotations:?}");
        };
        let corners = [[-1.5, 5.5], [-3.5, 5.5], [-3.5, 3.5], [-1.5, 3.5]];
        assert_near(&points(square), &corners);
        assert_near(&points(outline), &[[8.5, 18.5], [12.5, 18.5], [10.5, 23.5]]);
        assert_near(&points(forecast), &[[10.5, 20.5], [10.5, 25.5]]);
        let arrow = points(arrow);
        assert_near(&arrow[..2], &[[10.5, 20.5], [10.5, 24.5]]);
        assert!(arrow[3][1] < 24.5, "barbs lie behind the tip: {arrow:?}");
        assert_eq!(annotations.texts.len(), 1, "an obstacle has no name");
        assert_eq!(annotations.texts[0].text, "arrow");
    }

    #[test]
    fn a_scene_in_metres_is_taken_back_to_the_image() {
        // A floor with 0.01 m per pixel, y up, origin at pixel (100, 200).
        let floor_from_image = Matrix3::new(0.01, 0.0, -1.0, 0.0, -0.01, 2.0, 0.0, 0.0, 1.0);
        let image_from_floor = floor_from_image
            .try_inverse()
            .expect("the matrix has an inverse");
        let scene = example(FRAME_FLOOR);
        let annotations = image_annotations(&scene, now(), Some(&image_from_floor));
        assert_near(
            &points(&annotations.points[2]),
            &[[1100.5, -1799.5], [1100.5, -2299.5]],
        );
        assert_eq!(
            image_annotations(&scene, now(), None).points.len(),
            0,
            "metres cannot be drawn over an image without the calibration"
        );
    }

    #[test]
    fn points_at_infinity_are_left_out() {
        let horizon = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 20.0);
        assert!(image_point([10.0, 20.0], &horizon).is_none());
        assert!(image_point([10.0, 19.0], &horizon).is_some());
    }

    #[test]
    fn poses_are_those_of_observed_markers() {
        let mut scene = example(FRAME_IMAGE);
        let found = poses(&scene, now());
        assert_eq!(found.frame_id, "image");
        let [pose] = &found.poses[..] else {
            panic!("{found:?}");
        };
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let orientation = pose.orientation.expect("a pose has an orientation");
        assert!((orientation.z - half).abs() < 1e-12 && (orientation.w - half).abs() < 1e-12);

        scene.objects[0].flags = HAS_HEADING;
        assert!(
            poses(&scene, now()).poses.is_empty(),
            "a forecast pose is not one that was seen"
        );
    }

    #[test]
    fn scene_updates_replace_everything_on_their_topic() {
        let scene = example(FRAME_FLOOR);
        let ids = |update: &SceneUpdate| {
            assert_eq!(
                update.deletions[0].r#type,
                scene_entity_deletion::Type::All as i32
            );
            let entities = update.entities.iter();
            entities
                .map(|entity| (entity.id.clone(), entity.frame_id.clone()))
                .collect::<Vec<_>>()
        };
        let on_floor = |id: &str| vec![(id.to_owned(), "floor".to_owned())];
        assert_eq!(ids(&robots(&scene, now())), on_floor("track 7"));
        assert_eq!(ids(&obstacles(&scene, now())), on_floor("track 9"));
        assert_eq!(ids(&forecasts(&scene, now())), on_floor("track 7"));
        assert_eq!(ids(&robots(&Scene::EMPTY, now())), []);
    }

    #[test]
    fn an_image_is_turned_over_and_a_floor_is_not() {
        let image = root_transform(FRAME_IMAGE, now());
        let floor = root_transform(FRAME_FLOOR, now());
        let rotation = |transform: &FrameTransform| {
            let q = transform.rotation.expect("a transform has a rotation");
            [q.x, q.y, q.z, q.w]
        };
        assert_eq!(image.child_frame_id, "image");
        assert_eq!(rotation(&image), [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(floor.child_frame_id, "floor");
        assert_eq!(rotation(&floor), [0.0, 0.0, 0.0, 1.0]);
    }
}
