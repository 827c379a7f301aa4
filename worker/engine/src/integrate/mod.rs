//! Integrators, and what they share: sampling, materials, lights, cameras.
