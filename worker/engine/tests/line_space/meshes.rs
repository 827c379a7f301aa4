//! Meshes that are hard on a Line Space.

use glam::{Affine3A, Quat, Vec3};
use lightshaft_engine::scene::{Mesh, Sphere};

use crate::common::{ball, mesh, soup, spheres};

/// The mesh with every position moved.
fn moved(source: &Mesh, to: impl Fn(Vec3) -> Vec3) -> Mesh {
    mesh(source.positions.iter().map(|&p| to(p)).collect(), source.triangles.clone(), vec![])
}

fn joined(a: &Mesh, b: &Mesh) -> Mesh {
    let base = a.positions.len() as u32;
    let positions = a.positions.iter().chain(&b.positions).copied().collect();
    let triangles = a.triangles.iter().copied().chain(b.triangles.iter().map(|t| t.map(|v| v + base)));
    mesh(positions, triangles.collect(), vec![])
}

fn quad() -> Mesh {
    mesh(vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 0.0, 1.0), Vec3::Z], vec![[0, 1, 2], [0, 2, 3]], vec![])
}

/// A closed box whose faces do not share vertices.
fn crate_box() -> Mesh {
    let (mut positions, mut triangles) = (vec![], vec![]);
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let base = positions.len() as u32;
            for [u, v] in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
                let mut corner = Vec3::ZERO;
                (corner[axis], corner[(axis + 1) % 3], corner[(axis + 2) % 3]) = (side, u, v);
                positions.push(corner);
            }
            triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        }
    }
    mesh(positions, triangles, vec![])
}

/// A ball without some of its triangles, and with others twice.
fn torn_ball() -> Mesh {
    let whole = ball(12, Vec3::ZERO, 1.0);
    let mut triangles: Vec<_> = whole.triangles.iter().copied().enumerate().filter(|(i, _)| i % 29 != 3).collect();
    triangles.extend(triangles.clone().into_iter().filter(|(i, _)| i % 41 == 7));
    mesh(whole.positions, triangles.into_iter().map(|(_, t)| t).collect(), vec![])
}

/// Every mesh with its name.
pub(crate) fn all() -> Vec<(&'static str, Mesh)> {
    let round = ball(12, Vec3::ZERO, 1.0);
    let turn = Quat::from_axis_angle(Vec3::new(0.3, 0.9, -0.2).normalize(), 0.7);
    let turned = Affine3A::from_rotation_translation(turn, Vec3::new(0.2, -0.1, 0.4));
    let balls = vec![
        Sphere { center: Vec3::ZERO, radius: 1.0, slot: 0 },
        Sphere { center: Vec3::new(1.5, 0.2, 0.0), radius: 0.8, slot: 0 },
    ];
    vec![
        ("ball", round.clone()),
        ("torn ball", torn_ball()),
        ("balls through each other", joined(&round, &moved(&round, |p| p * 0.8 + Vec3::new(0.7, 0.2, 0.1)))),
        ("ball in a ball", joined(&round, &moved(&round, |p| p * 0.4))),
        ("box", crate_box()),
        ("turned box", moved(&crate_box(), |p| turned.transform_point3(p))),
        ("flat quad", quad()),
        ("turned quad", moved(&quad(), |p| turned.transform_point3(p))),
        (
            "one triangle",
            mesh(vec![Vec3::ZERO, Vec3::new(1.0, 0.2, 0.1), Vec3::new(0.1, 0.9, 0.7)], vec![[0, 1, 2]], vec![]),
        ),
        ("needle", mesh(vec![Vec3::ZERO, Vec3::X, 2.0 * Vec3::X], vec![[0, 1, 2]], vec![])),
        ("soup", soup(60, 0.4, 9)),
        ("dust", soup(2000, 0.01, 10)),
        ("huge ball", moved(&round, |p| p * 1e30)),
        ("tiny ball", moved(&round, |p| p * 1e-15)),
        ("far ball", moved(&round, |p| p + Vec3::new(4e4, -3e4, 7e4))),
        ("thin ball", moved(&round, |p| p * Vec3::new(1.0, 0.003, 1.0))),
        ("spheres", mesh(vec![], vec![], balls)),
        ("spheres and triangles", {
            let soup = soup(40, 0.3, 12);
            mesh(soup.positions, soup.triangles, spheres(30, 0.15, 13))
        }),
    ]
}
