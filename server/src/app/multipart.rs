//! Uploads in parts (multipart/form-data).

use axum::extract::multipart::{Field, Multipart, MultipartError};
use axum::extract::{FromRequest, Request};

use super::App;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use crate::web::body::upload;

/// Begins to read the parts of a request of at most `limit` bytes.
pub(super) async fn open(request: Request, limit: u64) -> ApiResult<Multipart> {
    let (parts, body) = request.into_parts();
    let body = upload(Request::from_parts(parts.clone(), body), limit)?;
    Multipart::from_request(Request::from_parts(parts, body), &())
        .await
        .map_err(|rejection| ApiError::bad_request("header/content-type", &rejection.body_text()))
}

impl App {
    pub(super) async fn next_part<'a>(&self, multipart: &'a mut Multipart) -> ApiResult<Option<Field<'a>>> {
        self.in_time(multipart.next_field()).await
    }

    /// The whole of a small part.
    pub(super) async fn read_part(&self, mut field: Field<'_>, limit: u64) -> ApiResult<Vec<u8>> {
        let mut bytes = Vec::new();
        while let Some(chunk) = self.in_time(field.chunk()).await? {
            bytes.extend_from_slice(&chunk);
            if bytes.len() as u64 > limit {
                return Err(ApiError::new(Code::TooLarge, format!("this part must be at most {limit} bytes")));
            }
        }
        Ok(bytes)
    }

    async fn in_time<T>(&self, next: impl Future<Output = Result<T, MultipartError>>) -> ApiResult<T> {
        match tokio::time::timeout(self.config.limits.upload_stall, next).await {
            Ok(next) => next.map_err(|error| {
                let detail = format!("the multipart body could not be read: {}", error.body_text());
                ApiError::new(Code::IncompleteBody, detail)
            }),
            Err(_) => Err(ApiError::new(Code::UploadStalled, "the upload stood still for too long")),
        }
    }
}
