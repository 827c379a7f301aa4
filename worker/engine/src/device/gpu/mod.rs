//! The GPU device: wgpu compute, wavefront kernels.
