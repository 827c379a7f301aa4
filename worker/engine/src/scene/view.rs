//! The view of a scene that brings no camera: all of it in the frame, from a little above, a quarter turn to the side.

use glam::Vec3;

use super::model::{Aabb, Camera, Projection, Scene};

const FOV_Y_RAD: f32 = 40.0 * std::f32::consts::PI / 180.0;
/// From the centre towards the eye: to the right, above and in front.
const TOWARDS_EYE: Vec3 = Vec3::new(0.55, 0.42, 1.0);
/// How much of the frame may stay empty around the scene.
const MARGIN: f32 = 1.06;

/// A camera that frames `scene` in a picture of `aspect` (width over height).
///
/// It is finite and looks at the scene however flat, large, far or empty that is.
pub fn default_camera(scene: &Scene, aspect: f32) -> Camera {
    frame(scene.world_bounds(), aspect)
}

fn frame(bounds: Aabb, aspect: f32) -> Camera {
    let aspect = if aspect.is_finite() { aspect.clamp(0.01, 100.0) } else { 1.0 };
    let usable = !bounds.is_empty() && bounds.extent().is_finite();
    let bounds = if usable { bounds } else { Aabb { min: Vec3::splat(-1.0), max: Vec3::splat(1.0) } };
    let center = bounds.min * 0.5 + bounds.max * 0.5;
    let towards_eye = TOWARDS_EYE.normalize();
    let forward = -towards_eye;
    let right = forward.cross(Vec3::Y).normalize();
    let up = right.cross(forward);

    // The least distance at which each corner of the box lies within the frustum.
    let tan_y = (0.5 * FOV_Y_RAD).tan();
    let tan_x = tan_y * aspect;
    let mut distance = 0.0_f32;
    for corner in 0..8_u32 {
        let pick = |axis: u32, low: f32, high: f32| if corner >> axis & 1 == 0 { low } else { high };
        let point = Vec3::new(
            pick(0, bounds.min.x, bounds.max.x),
            pick(1, bounds.min.y, bounds.max.y),
            pick(2, bounds.min.z, bounds.max.z),
        );
        let offset = point - center;
        let towards = offset.dot(towards_eye);
        let across = (offset.dot(right).abs() / tan_x).max(offset.dot(up).abs() / tan_y);
        distance = distance.max(towards + across);
    }
    // A point has no size to frame; far from the origin, a step must also be one that f32 can hold there.
    let least = (center.abs().max_element() * 1e-4).max(1e-3);
    let distance = (distance * MARGIN).max(least);
    Camera {
        name: "default".into(),
        position: center + towards_eye * distance,
        forward,
        up,
        projection: Projection::Perspective { fov_y_rad: FOV_Y_RAD },
        frame_aspect: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where a point lands, in units of half the picture.
    fn project(camera: &Camera, aspect: f32, point: Vec3) -> (f32, f32, f32) {
        let offset = point - camera.position;
        let depth = offset.dot(camera.forward);
        let right = camera.forward.cross(camera.up);
        let tan = (0.5 * FOV_Y_RAD).tan();
        (offset.dot(right) / depth / tan / aspect, offset.dot(camera.up) / depth / tan, depth)
    }

    #[test]
    fn every_corner_of_any_box_is_in_the_frame_and_fills_it() {
        let boxes = [
            (Vec3::splat(-1.0), Vec3::splat(1.0)),
            (Vec3::new(-50.0, 0.0, -80.0), Vec3::new(50.0, 0.0, 80.0)),
            (Vec3::new(1e4, 1e4, 1e4), Vec3::new(1.1e4, 1.2e4, 1.01e4)),
            (Vec3::splat(-1e15), Vec3::splat(1e15)),
            (Vec3::new(0.0, -10.0, 0.0), Vec3::new(0.1, 10.0, 0.1)),
        ];
        for (min, max) in boxes {
            for aspect in [0.5, 1.0, 16.0 / 9.0] {
                let camera = frame(Aabb { min, max }, aspect);
                let mut most = 0.0_f32;
                for corner in 0..8 {
                    let at = |axis: usize| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
                    let (x, y, depth) = project(&camera, aspect, Vec3::new(at(0), at(1), at(2)));
                    assert!(depth > 0.0 && x.abs() <= 1.0 && y.abs() <= 1.0, "{min} {max}: {x} {y} {depth}");
                    most = most.max(x.abs()).max(y.abs());
                }
                assert!(most > 0.7, "{min} to {max} at {aspect} fills only {most} of the frame");
            }
        }
    }

    #[test]
    fn nothing_a_point_and_infinity_still_give_a_camera() {
        let point = Vec3::new(3e6, 0.0, -7.0);
        let endless = Aabb { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY };
        for bounds in [Aabb::EMPTY, Aabb { min: point, max: point }, endless] {
            for aspect in [1.5, 0.0, f32::NAN] {
                let camera = frame(bounds, aspect);
                assert!(camera.position.is_finite(), "{bounds:?}");
                assert!((camera.forward.length() - 1.0).abs() < 1e-5 && (camera.up.length() - 1.0).abs() < 1e-5);
                assert!(camera.forward.dot(camera.up).abs() < 1e-5);
            }
        }
        let camera = frame(Aabb { min: point, max: point }, 1.0);
        assert!(camera.position.distance(point) > 1.0, "the eye must not sit in the point");
    }
}
