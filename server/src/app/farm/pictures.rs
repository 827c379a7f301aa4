//! Pictures of cases: read from blobs, judged on a thread of their own, kept with heat maps.

use std::convert::Infallible;

use bytes::Bytes;
use lightshaft_api::farm::{AcceptedPicture, ImageTolerance, ImageVerdict, PictureSource};
use lightshaft_api::job::Artifact;

use super::super::App;
use crate::error::{ApiError, ApiResult};
use crate::farm::{Decoded, JudgedPicture, Known, judge_picture};
use lightshaft_worker::picture::compare::{Pixels, difference_png, heat_map_png};

/// Accepted pictures that one is compared with, the newest first: each takes a FLIP.
const MOST_COMPARED: usize = 8;
/// By how much differences are multiplied in their picture.
const DIFFERENCE_GAIN: f32 = 8.0;

/// What came of a case's pictures.
pub(super) struct PictureFindings {
    pub(super) judged: JudgedPicture,
    /// Named, and to be kept.
    pub(super) artifacts: Vec<Artifact>,
}

impl App {
    /// Judges the pictures that a case's samples left, one list of artifacts each. `None` when the first left no picture.
    pub(super) async fn judge_pictures(
        &self,
        tolerance: &ImageTolerance,
        samples: &[Vec<Artifact>],
        accepted: &[AcceptedPicture],
    ) -> ApiResult<Option<PictureFindings>> {
        let Some(first) = samples.first() else { return Ok(None) };
        let Some((source, main)) = picture_of(first) else { return Ok(None) };
        let _turn = self.picture_turn().await?;
        let keeps_all = tolerance.z_test().is_some();
        let mut pictures = vec![self.decode(source, main).await?];
        for (_, picture) in samples[1..].iter().filter_map(|artifacts| picture_of(artifacts)) {
            if picture.hash == main.hash && !keeps_all {
                continue;
            }
            let decoded = self.decode(source, picture).await?;
            // One that differs tells that they do.
            if keeps_all || (pictures.len() == 1 && decoded.pixels != pictures[0].pixels) {
                pictures.push(decoded);
            }
        }
        let is_known = accepted.iter().any(|known| known.pixels == pictures[0].pixels);
        let mut known = Vec::new();
        for picture in accepted.iter().rev().take(if is_known { accepted.len() } else { MOST_COMPARED }) {
            let renderings = if is_known { Vec::new() } else { self.renderings(picture, keeps_all).await? };
            known.push(Known { pixels: picture.pixels.clone(), renderings });
        }
        let mut artifacts = named_pictures(first);
        if keeps_all {
            for (i, (_, picture)) in samples.iter().filter_map(|artifacts| picture_of(artifacts)).enumerate() {
                artifacts.push(Artifact { name: sample_name(i, source), ..picture.clone() });
            }
        }
        let tolerance = tolerance.clone();
        let (judged, maps) = blocking(move || {
            let judged = judge_picture(&tolerance, &pictures, &known);
            let maps = judged.as_ref().map(|judged| pictures_of_change(judged, &pictures[0], &known)).transpose();
            (judged, maps)
        })
        .await?;
        let Some(judged) = judged else { return Ok(None) };
        for (name, png) in maps.map_err(ApiError::internal)?.unwrap_or_default() {
            artifacts.push(self.keep_png(name, png).await?);
        }
        if judged.result.verdict == ImageVerdict::Changed
            && let Some(picture) = accepted.iter().find(|one| Some(&one.pixels) == judged.result.accepted.as_ref())
        {
            for file in named_pictures(&picture.artifacts) {
                artifacts.push(Artifact { name: file.name.replace("image.", "accepted."), ..file });
            }
        }
        Ok(Some(PictureFindings { judged, artifacts }))
    }

    async fn decode(&self, source: PictureSource, file: &Artifact) -> ApiResult<Decoded> {
        let bytes = self.picture_bytes(&file.hash).await?;
        let max_pixels = self.config.limits.picture_pixels;
        let decoded = blocking(move || {
            let pixels = Pixels::read(&bytes, "color", max_pixels).map_err(|error| error.to_string())?;
            let image = pixels.image().map_err(|error| error.to_string())?;
            Ok::<_, String>(Decoded::new(source, image))
        });
        decoded.await?.map_err(ApiError::internal)
    }

    /// The renderings of an accepted picture that can be read: one, or all that a Z-test needs.
    async fn renderings(&self, picture: &AcceptedPicture, all: bool) -> ApiResult<Vec<Decoded>> {
        let named = |name: &str| picture.artifacts.iter().find(|file| file.name == name);
        let samples = (0..).map_while(|i| named(&sample_name(i, picture.source)));
        let mut files: Vec<&Artifact> = samples.take(if all { usize::MAX } else { 0 }).collect();
        if files.is_empty() {
            // Also where a Z-test judges what was accepted before it did: the verdict says what is missing.
            files.extend(named(image_name(picture.source)));
        }
        let mut renderings = Vec::new();
        for file in files {
            renderings.push(self.decode(picture.source, file).await?);
        }
        Ok(renderings)
    }

    async fn keep_png(&self, name: &str, png: Vec<u8>) -> ApiResult<Artifact> {
        let length = png.len() as u64;
        let stream = futures::stream::iter([Ok::<_, Infallible>(Bytes::from(png))]);
        let staged = self.blobs.stage(stream, length, self.config.limits.upload_stall).await?;
        let hash = staged.hash().to_owned();
        self.blobs.commit(staged).await.map_err(ApiError::internal)?;
        Ok(Artifact {
            name: name.to_owned(),
            media_type: "image/png".to_owned(),
            bytes: length,
            href: format!("/v1/blobs/{hash}"),
            hash,
        })
    }
}

/// The file by which a job's picture is judged.
pub(super) fn picture_of(artifacts: &[Artifact]) -> Option<(PictureSource, &Artifact)> {
    [PictureSource::Exr, PictureSource::Png]
        .into_iter()
        .find_map(|source| Some((source, artifacts.iter().find(|file| file.name == image_name(source))?)))
}

fn image_name(source: PictureSource) -> &'static str {
    match source {
        PictureSource::Exr => "image.exr",
        PictureSource::Png => "image.png",
    }
}

fn sample_name(index: usize, source: PictureSource) -> String {
    format!("sample-{index}.{}", source.as_str())
}

fn named_pictures(artifacts: &[Artifact]) -> Vec<Artifact> {
    artifacts.iter().filter(|file| matches!(file.name.as_str(), "image.png" | "image.exr")).cloned().collect()
}

type NamedPng = (&'static str, Vec<u8>);

/// Where a changed picture differs from the accepted one.
fn pictures_of_change(judged: &JudgedPicture, picture: &Decoded, known: &[Known]) -> Result<Vec<NamedPng>, String> {
    let Some((index, flip)) = judged.compared.as_ref().filter(|_| judged.result.verdict == ImageVerdict::Changed)
    else {
        return Ok(Vec::new());
    };
    let Some(reference) = known.get(*index).and_then(|known| known.renderings.first()) else { return Ok(Vec::new()) };
    let (a, b) = (Pixels::color(&reference.image), Pixels::color(&picture.image));
    let heat_map = heat_map_png(flip).map_err(|error| error.to_string())?;
    let difference = difference_png(&a, &b, DIFFERENCE_GAIN).map_err(|error| error.to_string())?;
    Ok(vec![("heat-map.png", heat_map), ("difference.png", difference)])
}

async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> ApiResult<T> {
    tokio::task::spawn_blocking(work).await.map_err(ApiError::internal)
}
