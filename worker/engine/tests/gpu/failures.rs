//! What goes wrong is said, or repaired.

use std::sync::atomic::{AtomicU32, Ordering};

use lightshaft_engine::device::gpu::{Context, GpuDevice, adapters};
use lightshaft_engine::device::{Device, DeviceError, Pass, Region};
use lightshaft_engine::film::PassFilm;
use lightshaft_engine::settings::Integrator;

use crate::scenes::{opaque, packed, settings};
use crate::{context, context_within};

#[test]
fn adapters_are_listed_and_selected_by_part_of_their_name() {
    let found = adapters();
    let name = &found.first().expect("there is an adapter").name;
    assert!(found.iter().all(|info| info.kind == "gpu" && info.max_binding_bytes >= 128 << 20));
    let part: String = name.chars().take(4).collect::<String>().to_uppercase();
    assert_eq!(&Context::open(Some(&part)).expect("opens").info.name, name);
}

#[test]
fn an_unknown_adapter_is_an_error_that_lists_the_known_ones() {
    let Err(DeviceError::NoAdapter(message)) = Context::open(Some("Voodoo 2")) else {
        panic!("opened an adapter that is not there");
    };
    assert!(message.contains("Voodoo 2") && message.contains(&context().info.name), "{message}");
}

#[test]
fn a_lost_device_is_opened_again_and_the_picture_is_the_same() {
    let settings = settings(Integrator::Direct);
    let scene = packed(&opaque(), &settings);
    let region = Region::full(&settings);
    let pass = Pass { region, first_sample: 0, samples: 4 };
    let mut expected = PassFilm::new(region);
    let mut device = GpuDevice::with_context(context());
    device
        .prepare(scene.clone(), &settings)
        .expect("prepares")
        .render(&pass, &mut expected, &|| false)
        .expect("renders");

    let doomed = context_within(u32::MAX, u64::MAX);
    let mut device = GpuDevice::with_context(doomed.clone());
    let mut renderer = device.prepare(scene.clone(), &settings).expect("prepares");
    let waves = AtomicU32::new(0);
    let lose_it_at_the_third_wave = || {
        if waves.fetch_add(1, Ordering::Relaxed) == 2 {
            doomed.destroy();
        }
        false
    };
    let mut film = PassFilm::new(region);
    renderer.render(&pass, &mut film, &lose_it_at_the_third_wave).expect("recovers");
    assert!(waves.into_inner() > 3, "the device was never lost");
    assert!(film.mean() == expected.mean(), "the picture differs after the loss");

    // The next job on the same device gets a new context too.
    let mut renderer = device.prepare(scene, &settings).expect("prepares");
    renderer.render(&pass, &mut film, &|| false).expect("renders");
    assert_eq!(device.info(), doomed.info, "another adapter took its place");
}

/// Losses at any wave and cancelled passes between them, one after the other on one device.
#[test]
fn losses_and_cancels_over_and_over_end_with_the_same_picture() {
    let settings = settings(Integrator::Ao { samples: 2, distance: 1.0 });
    let scene = packed(&opaque(), &settings);
    let region = Region::full(&settings);
    let pass = Pass { region, first_sample: 0, samples: 4 };
    let mut device = GpuDevice::with_context(context_within(u32::MAX, u64::MAX));
    let mut expected = PassFilm::new(region);
    let mut renderer = device.prepare(scene.clone(), &settings).expect("prepares");
    renderer.render(&pass, &mut expected, &|| false).expect("renders");
    for round in 0..6 {
        let mut renderer = device.prepare(scene.clone(), &settings).expect("prepares");
        let doomed = device.context().clone();
        let waves = AtomicU32::new(0);
        let lose = || {
            if waves.fetch_add(1, Ordering::Relaxed) == round % 4 {
                doomed.destroy();
            }
            false
        };
        let mut film = PassFilm::new(region);
        renderer.render(&pass, &mut film, &lose).expect("recovers");
        assert!(film.mean() == expected.mean(), "round {round}: the picture differs after the loss");
        let unchanged = film.clone();
        assert!(matches!(renderer.render(&pass, &mut film, &|| true), Err(DeviceError::Cancelled)));
        assert!(film == unchanged, "round {round}: the cancelled pass left something");
    }
}

#[test]
fn a_cancelled_pass_leaves_the_film_alone() {
    let settings = settings(Integrator::Direct);
    let region = Region::full(&settings);
    let mut device = GpuDevice::with_context(context());
    let mut renderer = device.prepare(packed(&opaque(), &settings), &settings).expect("prepares");
    let mut film = PassFilm::new(region);
    let asked = AtomicU32::new(0);
    let cancel = || asked.fetch_add(1, Ordering::Relaxed) == 1;
    let pass = Pass { region, first_sample: 0, samples: 64 };
    assert!(matches!(renderer.render(&pass, &mut film, &cancel), Err(DeviceError::Cancelled)));
    assert!(film == PassFilm::new(region), "the film was written");
}

#[test]
fn a_pass_outside_its_film_is_refused() {
    let settings = settings(Integrator::Direct);
    let region = Region::full(&settings);
    let mut device = GpuDevice::with_context(context());
    let mut renderer = device.prepare(packed(&opaque(), &settings), &settings).expect("prepares");
    let mut film = PassFilm::new(Region { width: 10, ..region });
    let pass = Pass { region, first_sample: 0, samples: 1 };
    assert!(matches!(renderer.render(&pass, &mut film, &|| false), Err(DeviceError::Other(_))));
}

#[test]
fn a_scene_that_needs_more_bindings_than_there_are_is_refused() {
    let settings = settings(Integrator::Direct);
    let context = context_within(8, 16 << 10);
    let mut device = GpuDevice::with_context(context);
    let Err(DeviceError::TooLarge(message)) = device.prepare(packed(&opaque(), &settings), &settings) else {
        panic!("prepared what does not fit");
    };
    assert!(message.contains("storage buffers") || message.contains("bindings"), "{message}");
}

#[test]
fn a_scene_beyond_all_bindings_is_refused_with_its_size() {
    let settings = settings(Integrator::Direct);
    let mut device = GpuDevice::with_context(context_within(u32::MAX, 4 << 10));
    let Err(DeviceError::TooLarge(message)) = device.prepare(packed(&opaque(), &settings), &settings) else {
        panic!("prepared what does not fit");
    };
    assert!(message.contains("KiB") && message.contains("4 bindings of 4 KiB"), "{message}");
}
