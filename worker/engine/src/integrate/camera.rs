//! Primary rays of perspective and orthographic cameras.

use glam::Vec3;

use super::math::normalize_or;
use crate::pack::PackedCamera;
use crate::scene::{Camera, Projection};
use crate::trace::Ray;

/// Prepares a camera for a picture of `width` x `height` square pixels. The view contains the camera's frame: its vertical
/// extent is the frame's, and more where the picture is narrower than the frame; the horizontal one follows from the
/// picture.
pub fn pack_camera(camera: &Camera, width: u32, height: u32) -> PackedCamera {
    let forward = normalize_or(camera.forward, Vec3::NEG_Z);
    let right = normalize_or(forward.cross(camera.up), super::math::basis(forward).0);
    let up = right.cross(forward);
    let aspect = width as f32 / height.max(1) as f32;
    let (half_height, orthographic) = match camera.projection {
        Projection::Perspective { fov_y_rad } => ((0.5 * fov_y_rad).tan(), 0),
        Projection::Orthographic { half_height } => (half_height, 1),
    };
    let half_height = half_height * camera.frame_aspect.map_or(1.0, |frame| (frame / aspect).max(1.0));
    PackedCamera {
        position: camera.position.to_array(),
        orthographic,
        forward: forward.to_array(),
        width,
        right: (right * (half_height * aspect)).to_array(),
        height,
        up: (up * half_height).to_array(),
        _pad: 0,
    }
}

/// The ray through a point of pixel `(x, y)`; `(0.5, 0.5)` is the pixel's centre, rows count downwards. The direction
/// is a unit vector, so `t` is the world-space distance.
pub fn camera_ray(camera: &PackedCamera, x: u32, y: u32, offset_x: f32, offset_y: f32) -> Ray {
    let sx = 2.0 * ((x as f32 + offset_x) / camera.width as f32) - 1.0;
    let sy = 1.0 - 2.0 * ((y as f32 + offset_y) / camera.height as f32);
    let position = Vec3::from_array(camera.position);
    let forward = Vec3::from_array(camera.forward);
    let shift = Vec3::from_array(camera.right) * sx + Vec3::from_array(camera.up) * sy;
    if camera.orthographic == 1 {
        Ray::new(position + shift, forward)
    } else {
        Ray::new(position, normalize_or(forward + shift, forward))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(projection: Projection) -> Camera {
        Camera {
            name: String::new(),
            position: Vec3::new(1.0, 2.0, 3.0),
            forward: Vec3::NEG_Z,
            up: Vec3::Y,
            projection,
            frame_aspect: None,
        }
    }

    #[test]
    fn perspective_corners_and_centre() {
        let packed = pack_camera(&camera(Projection::Perspective { fov_y_rad: std::f32::consts::FRAC_PI_2 }), 200, 100);
        assert!((camera_ray(&packed, 100, 50, 0.0, 0.0).direction - Vec3::NEG_Z).length() < 1e-6);
        let top_left = camera_ray(&packed, 0, 0, 0.0, 0.0);
        assert!((top_left.direction - Vec3::new(-2.0, 1.0, -1.0).normalize()).length() < 1e-6);
        assert_eq!(top_left.origin, Vec3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn orthographic_rays_are_parallel() {
        let packed = pack_camera(&camera(Projection::Orthographic { half_height: 3.0 }), 100, 100);
        let ray = camera_ray(&packed, 99, 99, 1.0, 1.0);
        assert_eq!(ray.direction, Vec3::NEG_Z);
        assert!((ray.origin - Vec3::new(4.0, -1.0, 3.0)).length() < 1e-5);
    }

    #[test]
    fn a_narrow_picture_keeps_the_width_of_the_cameras_frame() {
        for projection in [Projection::Orthographic { half_height: 3.0 }, Projection::Perspective { fov_y_rad: 1.0 }] {
            let of = |frame_aspect, width, height| {
                let packed = pack_camera(&Camera { frame_aspect, ..camera(projection) }, width, height);
                (Vec3::from_array(packed.right).length(), Vec3::from_array(packed.up).length())
            };
            let (_, height) = of(None, 100, 100);
            let close = |got: (f32, f32), x: f32, y: f32| {
                assert!((got.0 - x).abs() + (got.1 - y).abs() < 1e-4, "{got:?}, expected {x} {y}");
            };
            close(of(Some(2.0), 100, 100), 2.0 * height, 2.0 * height);
            close(of(Some(2.0), 200, 100), 2.0 * height, height);
            close(of(Some(2.0), 400, 100), 4.0 * height, height);
            close(of(Some(0.5), 100, 100), height, height);
        }
    }

    #[test]
    fn an_up_vector_along_the_view_still_gives_a_frame() {
        let mut c = camera(Projection::Perspective { fov_y_rad: 1.0 });
        c.up = c.forward;
        let packed = pack_camera(&c, 10, 10);
        assert!(Vec3::from_array(packed.right).length() > 0.1 && Vec3::from_array(packed.up).length() > 0.1);
    }
}
