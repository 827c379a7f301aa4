//! The dashboard in a real browser, as people use it.

mod actions;
mod compare;
mod farm;
mod form;
mod pages;
mod upload;

/// True once the first picture in `selector` has been decoded and has pixels.
fn decoded(selector: &str) -> String {
    format!("const i = document.querySelector('{selector}'); return !!i && i.complete && i.naturalWidth > 0")
}

/// True once the text of `selector` holds `text`.
fn says(selector: &str, text: &str) -> String {
    format!("return !!document.querySelector('{selector}')?.innerText.includes({text:?})")
}
