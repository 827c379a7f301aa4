//! The CPU device: rayon over tiles, native kernels.
