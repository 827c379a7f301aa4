// Twin of integrate/camera.rs.

fn camera_ray(x: u32, y: u32, offset_x: f32, offset_y: f32) -> Ray {
    let camera = scene.camera;
    let sx = 2.0 * ((f32(x) + offset_x) / f32(camera.width)) - 1.0;
    let sy = 1.0 - 2.0 * ((f32(y) + offset_y) / f32(camera.height));
    let shift = camera.right * sx + camera.up * sy;
    if camera.orthographic == 1u {
        return Ray(camera.position + shift, 0.0, camera.forward, infinity());
    }
    return Ray(camera.position, 0.0, normalize_or(camera.forward + shift, camera.forward), infinity());
}
