//! How far two pictures are apart, in numbers and as a picture: RMSE, relative MSE, MAE, PSNR, mean ratio, largest
//! difference and where, count of differing pixels, SSIM, FLIP with its heat map (of what a display shows, or of every
//! exposure of high-dynamic-range images), a Z-test for sampled effects; and how far two timings are apart. Pure functions;
//! no IO.
//!
//! ```
//! use lightshaft_compare::{Image, Options, compare};
//!
//! let grey = Image::new(8, 8, vec![[0.5; 3]; 64])?;
//! let brighter = Image::new(8, 8, vec![[0.55; 3]; 64])?;
//! let comparison = compare(&grey, &brighter, &Options::default())?;
//! assert!((comparison.report.differences.mean_ratio.unwrap() - 1.1).abs() < 1e-6);
//! # Ok::<(), lightshaft_compare::Error>(())
//! ```

mod error;
mod flip;
mod hdr_flip;
mod heat_map;
mod image;
mod normal;
mod plane;
mod psnr;
mod report;
mod scale_bar;
mod ssim;
#[cfg(test)]
mod test_images;
pub mod timing;
mod z_test;

pub use error::{Differences, REL_MSE_EPSILON, differences};
pub use flip::{PIXELS_PER_DEGREE, flip};
pub use hdr_flip::{Exposures, HdrFlip, hdr_flip};
pub use heat_map::heat_map;
pub use image::{Error, Image};
pub use plane::Plane;
pub use psnr::psnr;
pub use report::{Comparison, Options, Report, compare};
pub use scale_bar::{Drawing, heat_map_with_scale};
pub use ssim::ssim;
pub use z_test::{LEAST_RENDERINGS, ZTest, ZTestLevel, ZTestOptions, z_test};
