//! The fields of what lights a scene, and of the ground that it stands on.

use lightshaft_api::settings::{Environment, EnvironmentMap, Ground, Light, LightKind, RenderSettings};

use super::{Control, Field, RGB, Section, XYZ, modes, name_of, number, optional, options, vector};

/// The sky; lights follow it, each with its own [`fields`].
pub(super) fn section(s: &RenderSettings) -> Section {
    let (mode, grey, color, map) = match &s.environment {
        None => ("", 1.0, [1.0; 3], None),
        Some(Environment::Grey(value)) => ("@grey", *value, [*value; 3], None),
        Some(Environment::Color(color)) => ("@color", 1.0, *color, None),
        Some(Environment::Map(map)) => ("@map", 1.0, [1.0; 3], Some(map)),
    };
    let start = EnvironmentMap { map: String::new(), intensity: 1.0, rotation_deg: 0.0 };
    let map = map.unwrap_or(&start);
    let choice = "/environment_mode";
    let fields = vec![
        Field::new(
            "/settings/environment",
            "Sky",
            "",
            "Automatic: a grey sky where the scene has no light, else black. Textures of emission are no light.",
            modes(
                mode,
                &[("", "Automatic"), ("@grey", "Grey"), ("@color", "A colour"), ("@map", "A map (HDR or EXR)")],
            ),
        )
        .named(choice),
        Field::new("/settings/environment", "Radiance", "", "0 is black.", number(grey, "0", ""))
            .when(choice, "@grey", mode),
        Field::new("/settings/environment", "Colour of the sky", "", "Linear radiance.", vector(color, RGB))
            .named("/settings/environment_color")
            .when(choice, "@color", mode),
        Field::new(
            "/settings/environment/map",
            "Map",
            "",
            "Hash of an equirectangular .hdr or .exr; choose a file to upload one.",
            Control::Text { value: map.map.clone(), placeholder: "64 hex digits" },
        )
        .when(choice, "@map", mode),
        Field::new("/settings/environment/intensity", "Brightness of the map", "×", "", number(map.intensity, "0", ""))
            .when(choice, "@map", mode),
        Field::new(
            "/settings/environment/rotation_deg",
            "Turned by",
            "°",
            "About the vertical axis.",
            number(map.rotation_deg, "", ""),
        )
        .when(choice, "@map", mode),
    ];
    Section { title: "Light", intro: "Beside the scene's own lights and emitting surfaces.", fields }
}

/// Fields of the light `index` of `/settings/lights`.
pub(in crate::dashboard) fn fields(index: &str, light: &Light) -> Vec<Field> {
    let at = |name: &str| format!("/settings/lights/{index}/{name}");
    let kind = at("kind");
    let mode = format!("\"{}\"", name_of(&light.kind));
    let kinds = options(&[light.kind], &["point", "spot", "directional"], &[("directional", "Directional (sun)")]);
    vec![
        Field::new(&kind, "Kind", "", "", Control::Choice { options: kinds }),
        Field::new(&at("color"), "Colour", "", "Linear.", vector(light.color, RGB)),
        Field::new(
            &at("intensity"),
            "Intensity",
            "",
            "Candela; lux for a directional light.",
            number(light.intensity, "0", ""),
        ),
        Field::new(&at("position"), "Position", "", "", vector(light.position.unwrap_or([0.0, 2.0, 0.0]), XYZ)).when(
            &kind,
            "\"point\" \"spot\"",
            &mode,
        ),
        Field::new(&at("direction"), "Shines to", "", "", vector(light.direction.unwrap_or([0.0, -1.0, 0.0]), XYZ))
            .when(&kind, "\"spot\" \"directional\"", &mode),
        Field::new(&at("range"), "Range", "units", "Empty: unlimited.", optional(light.range, "0", "")).when(
            &kind,
            "\"point\" \"spot\"",
            &mode,
        ),
        Field::new(&at("inner_cone_deg"), "Inner cone", "°", "Half angle.", optional(light.inner_cone_deg, "0", "90"))
            .when(&kind, "\"spot\"", &mode),
        Field::new(&at("outer_cone_deg"), "Outer cone", "°", "Half angle.", optional(light.outer_cone_deg, "0", "90"))
            .when(&kind, "\"spot\"", &mode),
    ]
}

/// What a new row of the form starts from.
pub(in crate::dashboard) fn new() -> Light {
    Light {
        kind: LightKind::Point,
        color: [1.0; 3],
        intensity: 100.0,
        position: Some([0.0, 2.0, 0.0]),
        direction: None,
        range: None,
        inner_cone_deg: None,
        outer_cone_deg: None,
    }
}

/// A plane below the scene.
pub(super) fn ground(ground: Option<&Ground>) -> Section {
    let mode = if ground.is_some() { "@plane" } else { "" };
    let start = Ground::default();
    let g = ground.unwrap_or(&start);
    let choice = "/ground_mode";
    let fields = vec![
        Field::new(
            "/settings/ground",
            "Ground",
            "",
            "Something for the scene to stand on.",
            modes(mode, &[("", "None"), ("@plane", "A plane")]),
        )
        .named(choice),
        Field::new(
            "/settings/ground/height",
            "Height",
            "units",
            "Empty: the scene's lowest point.",
            optional(g.height, "", ""),
        )
        .when(choice, "@plane", mode),
        Field::new(
            "/settings/ground/half_size",
            "Half side length",
            "units",
            "Empty: 20 scene radii.",
            optional(g.half_size, "0", ""),
        )
        .when(choice, "@plane", mode),
        Field::new("/settings/ground/albedo", "Albedo", "", "Linear, 0 to 1.", vector(g.albedo, RGB))
            .when(choice, "@plane", mode),
        Field::new("/settings/ground/roughness", "Roughness", "", "0 to 1.", number(g.roughness, "0", "1"))
            .when(choice, "@plane", mode),
    ];
    Section { title: "Ground", intro: "", fields }
}
