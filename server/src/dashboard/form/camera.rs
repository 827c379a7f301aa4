//! The fields of the camera.

use lightshaft_api::scene::Scene;
use lightshaft_api::settings::{CameraChoice, CustomCamera};

use super::{ChoiceOption, Control, Field, Section, XYZ, number, optional, vector};

/// One of the scene's cameras, or a view of one's own.
pub(super) fn section(choice: Option<&CameraChoice>, scene: Option<&Scene>) -> Section {
    let custom = match choice {
        Some(CameraChoice::Custom(camera)) => Some(camera),
        _ => None,
    };
    let cameras = scene.map(|scene| scene.summary.cameras.as_slice()).unwrap_or_default();
    let current = match choice {
        None => String::new(),
        Some(CameraChoice::Index(index)) => index.to_string(),
        Some(CameraChoice::Name(name)) => match cameras.iter().position(|camera| camera.name == *name) {
            Some(index) => index.to_string(),
            None => serde_json::Value::from(name.as_str()).to_string(),
        },
        Some(CameraChoice::Custom(camera)) if camera.half_height.is_some() => "@orthographic".to_owned(),
        Some(CameraChoice::Custom(_)) => "@perspective".to_owned(),
    };
    let default = if cameras.is_empty() { "Frame the whole scene" } else { "The scene's first camera" };
    let mut options = vec![(String::new(), default.to_owned())];
    for (index, camera) in cameras.iter().enumerate() {
        options.push((index.to_string(), format!("{index}: {} ({})", camera.name, camera.kind)));
    }
    if !options.iter().any(|(value, _)| *value == current) && custom.is_none() {
        options.push((current.clone(), current.clone()));
    }
    options.push(("@perspective".to_owned(), "Another view, perspective".to_owned()));
    options.push(("@orthographic".to_owned(), "Another view, orthographic".to_owned()));
    let options =
        options.into_iter().map(|(value, label)| ChoiceOption { selected: value == current, value, label }).collect();
    let start = CustomCamera {
        position: [0.0, 1.0, 4.0],
        target: [0.0; 3],
        up: [0.0, 1.0, 0.0],
        fov_y_deg: None,
        half_height: None,
    };
    let c = custom.unwrap_or(&start);
    const OWN: &str = "@perspective @orthographic";
    let view = "/settings/camera";
    let fields = vec![
        Field::new(view, "Camera", "", "", Control::Choice { options }),
        Field::new("/settings/camera/position", "Position", "", "World units.", vector(c.position, XYZ))
            .when(view, OWN, &current),
        Field::new("/settings/camera/target", "Looks at", "", "", vector(c.target, XYZ)).when(view, OWN, &current),
        Field::new("/settings/camera/up", "Up", "", "", vector(c.up, XYZ)).when(view, OWN, &current),
        Field::new(
            "/settings/camera/fov_y_deg",
            "Vertical field of view",
            "°",
            "Empty: 40°.",
            optional(c.fov_y_deg, "0", "180"),
        )
        .when(view, "@perspective", &current),
        Field::new(
            "/settings/camera/half_height",
            "Half height of the view",
            "units",
            "",
            number(c.half_height.unwrap_or(1.0), "0", ""),
        )
        .when(view, "@orthographic", &current),
    ];
    Section { title: "Camera", intro: "", fields }
}
