//! The shaft of a ray, bit for bit the same on both devices.

use lightshaft_engine::accel::line_space::shaft::{directed_index, symmetric_index};
use lightshaft_engine::accel::line_space::{Location, ShaftGrid};
use lightshaft_engine::device::gpu::{LocatedShaft, locate_shafts};
use lightshaft_engine::scene::Aabb;
use lightshaft_engine::trace::Ray;

use crate::common::{Random, hard_ray};
use crate::context;

fn on_cpu(grid: &ShaftGrid, ray: &Ray) -> LocatedShaft {
    match grid.locate(ray) {
        Location::Beside => LocatedShaft::default(),
        Location::TooFar => LocatedShaft { flags: LocatedShaft::TOO_FAR, ..LocatedShaft::default() },
        Location::Through(chord) => LocatedShaft {
            flags: LocatedShaft::THROUGH
                | if chord.starts_outside { LocatedShaft::STARTS_OUTSIDE } else { 0 }
                | if chord.reaches_exit { LocatedShaft::REACHES_EXIT } else { 0 },
            symmetric: symmetric_index(grid.n(), chord.entry, chord.exit),
            directed: directed_index(grid.n(), chord.entry, chord.exit),
        },
    }
}

#[test]
fn both_devices_locate_every_ray_in_the_same_shaft() {
    let aabb = |min: [f32; 3], max: [f32; 3]| Aabb { min: min.into(), max: max.into() };
    let boxes = [
        aabb([0.0; 3], [1.0; 3]),
        aabb([-3.0, 2.0, -0.5], [4.0, 2.1, 11.0]),
        aabb([-5.0, 1.0, -5.0], [5.0, 1.0, 5.0]),
        aabb([1.0e6, -2.0e6, 3.0e5], [1.000_01e6, -1.999_99e6, 3.0001e5]),
        aabb([-1.0e30; 3], [2.0e30, 1.0e30, 3.0e30]),
    ];
    const RAYS: usize = 50_000;
    let context = context();
    let mut random = Random(11);
    let mut through = 0;
    for bounds in boxes {
        for n in [1, 3, 4, 6, 10, 16, 31, 32] {
            let grid = ShaftGrid::new(&bounds, n).expect("usable");
            let rays: Vec<Ray> = (0..RAYS).map(|_| hard_ray(&mut random, &grid, &bounds)).collect();
            let found = locate_shafts(&context, &grid, &rays).expect("runs");
            for (ray, gpu) in rays.iter().zip(found) {
                let cpu = on_cpu(&grid, ray);
                assert_eq!(gpu, cpu, "{ray:?} in {grid:?}");
                through += usize::from(cpu.flags & LocatedShaft::THROUGH != 0);
            }
        }
    }
    assert!(through > RAYS * boxes.len() * 8 / 2, "only {through} rays go through: the test says little");
}
