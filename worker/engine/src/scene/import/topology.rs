//! From a primitive's topology and indices to triangles (glTF 2.0, 3.7.2.1).

use crate::scene::error::{ImportError, Result};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Topology {
    Points,
    Lines,
    Triangles,
    TriangleStrip,
    TriangleFan,
}

impl Topology {
    /// By glTF's `mode`, which [`check`](super::check) has held to 0..=6.
    pub(super) fn from_mode(mode: u32) -> Self {
        match mode {
            0 => Self::Points,
            4 => Self::Triangles,
            5 => Self::TriangleStrip,
            6 => Self::TriangleFan,
            _ => Self::Lines,
        }
    }

    /// Triangles that `indices` indices make.
    pub(super) fn triangle_count(self, indices: u64) -> u64 {
        match self {
            Self::Points | Self::Lines => 0,
            Self::Triangles => indices / 3,
            Self::TriangleStrip | Self::TriangleFan => indices.saturating_sub(2),
        }
    }

    /// The triangles, all with the winding that the topology means.
    pub(super) fn triangles(self, indices: &[u32]) -> Vec<[u32; 3]> {
        match self {
            Self::Points | Self::Lines => Vec::new(),
            Self::Triangles => indices.chunks_exact(3).map(|three| [three[0], three[1], three[2]]).collect(),
            Self::TriangleStrip => indices
                .windows(3)
                .enumerate()
                .map(
                    |(i, three)| {
                        if i % 2 == 0 { [three[0], three[1], three[2]] } else { [three[0], three[2], three[1]] }
                    },
                )
                .collect(),
            Self::TriangleFan => match indices {
                [] => Vec::new(),
                [hub, rim @ ..] => rim.windows(2).map(|two| [*hub, two[0], two[1]]).collect(),
            },
        }
    }
}

/// An error at `at` unless all indices are below `vertices`.
pub(super) fn check_range(indices: &[u32], vertices: usize, at: &str) -> Result<()> {
    // The maximum first: it is quick, and nearly always enough.
    let most = indices.iter().copied().max().unwrap_or(0);
    if indices.is_empty() || (most as usize) < vertices {
        return Ok(());
    }
    let place = indices.iter().position(|index| *index as usize >= vertices).unwrap_or(0);
    Err(ImportError::malformed(
        at,
        format!("index {} at place {place} is out of range: POSITION has {vertices} vertices", indices[place]),
    ))
}

/// Renumbers `indices` so that only vertices in use remain, in their old order; the answer lists their old numbers.
/// `None` when all are in use, and nothing changes.
pub(super) fn compact(indices: &mut [u32], vertices: usize) -> Option<Vec<u32>> {
    const UNUSED: u32 = u32::MAX;
    let mut renumbered = vec![UNUSED; vertices];
    for index in indices.iter() {
        renumbered[*index as usize] = 0;
    }
    let used: Vec<u32> = (0..vertices as u32).filter(|old| renumbered[*old as usize] != UNUSED).collect();
    if used.len() == vertices {
        return None;
    }
    for (new, old) in used.iter().enumerate() {
        renumbered[*old as usize] = new as u32;
    }
    for index in indices {
        *index = renumbered[*index as usize];
    }
    Some(used)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_alternate_so_that_the_winding_stays() {
        assert_eq!(Topology::TriangleStrip.triangles(&[0, 1, 2, 3, 4]), [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
        assert_eq!(Topology::TriangleStrip.triangle_count(5), 3);
    }

    #[test]
    fn fans_share_their_first_vertex() {
        assert_eq!(Topology::TriangleFan.triangles(&[7, 1, 2, 3]), [[7, 1, 2], [7, 2, 3]]);
        assert_eq!(Topology::TriangleFan.triangles(&[]), [[0; 3]; 0]);
        assert_eq!(Topology::TriangleFan.triangle_count(1), 0);
    }

    #[test]
    fn compaction_keeps_the_order_of_the_used_vertices() {
        let mut indices = [5, 2, 9];
        assert_eq!(compact(&mut indices, 10), Some(vec![2, 5, 9]));
        assert_eq!(indices, [1, 0, 2]);
        assert_eq!(compact(&mut [1, 0], 2), None);
    }
}
