//! Template filters: numbers, sizes, durations and times as people read them.
#![expect(unreachable_pub, reason = "`askama::filter_fn` makes public types")]

use askama::Values;
use askama::filters::Safe;
use jiff::{Timestamp, Unit};

/// Numbers of any type, so that one filter serves them all.
pub(super) trait Number {
    fn as_f64(&self) -> f64;
}

macro_rules! numbers {
    ($($type:ty),*) => { $(impl Number for $type {
        #[allow(clippy::unnecessary_cast, reason = "one macro for all number types")]
        fn as_f64(&self) -> f64 { *self as f64 }
    })* };
}
numbers!(u16, u32, u64, usize, i32, i64, f32, f64);

impl<T: Number> Number for &T {
    fn as_f64(&self) -> f64 {
        (**self).as_f64()
    }
}

/// A point in time, by value or by reference.
pub(super) trait Instant {
    fn at(&self) -> Timestamp;
}

impl Instant for Timestamp {
    fn at(&self) -> Timestamp {
        *self
    }
}

impl<T: Instant> Instant for &T {
    fn at(&self) -> Timestamp {
        (**self).at()
    }
}

/// `1536` as `1.5 KiB`.
#[askama::filter_fn]
pub(super) fn bytes(value: impl Number, _: &dyn Values) -> askama::Result<String> {
    Ok(human_bytes(value.as_f64()))
}

/// `1234567` as `1,234,567`.
#[askama::filter_fn]
pub(super) fn count(value: impl Number, _: &dyn Values) -> askama::Result<String> {
    Ok(human_count(value.as_f64()))
}

/// `1234567` as `1.23 M`.
#[askama::filter_fn]
pub(super) fn short(value: impl Number, _: &dyn Values) -> askama::Result<String> {
    Ok(human_short(value.as_f64()))
}

/// Seconds as `340 ms`, `12.4 s`, `3 min 05 s` or `2 h 10 min`.
#[askama::filter_fn]
pub(super) fn seconds(value: impl Number, _: &dyn Values) -> askama::Result<String> {
    Ok(human_seconds(value.as_f64()))
}

/// `0.423` as `42 %`.
#[askama::filter_fn]
pub(super) fn percent(value: impl Number, _: &dyn Values) -> askama::Result<String> {
    Ok(format!("{:.0} %", (value.as_f64() * 100.0).clamp(0.0, 100.0).floor()))
}

/// `0.0042` as `0.4 %`: a part of a whole, rounded.
#[askama::filter_fn]
pub(super) fn share(value: impl Number, _: &dyn Values) -> askama::Result<String> {
    let percent = value.as_f64() * 100.0;
    Ok(if percent < 0.95 { format!("{percent:.1} %") } else { format!("{percent:.0} %") })
}

/// At most three significant digits: `0.00123`, `12.3`, `1,230`.
#[askama::filter_fn]
pub(super) fn number(value: impl Number, _: &dyn Values) -> askama::Result<String> {
    Ok(human_number(value.as_f64()))
}

/// `3 min ago`.
#[askama::filter_fn]
pub(super) fn ago(value: impl Instant, _: &dyn Values) -> askama::Result<String> {
    Ok(human_ago(value.at(), Timestamp::now()))
}

/// `2026-11-22 14:03:05 UTC`.
#[askama::filter_fn]
pub(super) fn utc(value: impl Instant, _: &dyn Values) -> askama::Result<String> {
    Ok(value.at().strftime("%Y-%m-%d %H:%M:%S UTC").to_string())
}

/// Of an id (UUID version 7) the time and the first random digits: what comes after the same millisecond differs here.
#[askama::filter_fn]
pub(super) fn short_id(value: impl AsRef<str>, _: &dyn Values) -> askama::Result<String> {
    Ok(value.as_ref().chars().take(18).collect())
}

/// The first twelve characters of a hash; the whole is in a title or link beside it.
#[askama::filter_fn]
pub(super) fn brief(value: impl AsRef<str>, _: &dyn Values) -> askama::Result<String> {
    Ok(value.as_ref().chars().take(12).collect())
}

/// `there is no worker` as `There is no worker.`
#[askama::filter_fn]
pub(super) fn sentence(value: impl AsRef<str>, _: &dyn Values) -> askama::Result<String> {
    let mut characters = value.as_ref().chars();
    let mut text: String = characters.next().into_iter().flat_map(char::to_uppercase).chain(characters).collect();
    if !text.ends_with(['.', '!', '?']) {
        text.push('.');
    }
    Ok(text)
}

/// `geometric_normal` as `Geometric normal`.
#[askama::filter_fn]
pub(super) fn words(value: impl AsRef<str>, _: &dyn Values) -> askama::Result<String> {
    Ok(human_words(value.as_ref()))
}

/// The name of an enum's value, as in JSON.
#[askama::filter_fn]
pub(super) fn name(value: impl serde::Serialize, _: &dyn Values) -> askama::Result<String> {
    Ok(super::form::name_of(&value))
}

/// One path segment or query value.
#[askama::filter_fn]
pub(super) fn segment(value: impl AsRef<str>, _: &dyn Values) -> askama::Result<String> {
    Ok(super::client::escape(value.as_ref()))
}

/// One part of a JSON pointer (RFC 6901).
#[askama::filter_fn]
pub(super) fn pointer(value: impl AsRef<str>, _: &dyn Values) -> askama::Result<String> {
    Ok(lightshaft_api::problem::escape_pointer(value.as_ref()))
}

pub(super) fn human_bytes(bytes: f64) -> String {
    let mut value = bytes;
    let mut units = ["B", "KiB", "MiB", "GiB", "TiB"].into_iter();
    let mut unit = units.next().unwrap_or_default();
    for next in units {
        if value < 1023.95 {
            break;
        }
        value /= 1024.0;
        unit = next;
    }
    if unit == "B" || value >= 99.95 { format!("{value:.0} {unit}") } else { format!("{value:.1} {unit}") }
}

pub(super) fn human_count(value: f64) -> String {
    let digits = format!("{:.0}", value.abs());
    let mut grouped = String::with_capacity(digits.len() + digits.len() / 3 + 1);
    if value < 0.0 {
        grouped.push('-');
    }
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    grouped
}

pub(super) fn human_short(value: f64) -> String {
    let (scale, unit) = match value.abs() {
        v if v < 1e4 => return human_count(value),
        v if v < 999.5e3 => (1e3, "k"),
        v if v < 999.5e6 => (1e6, "M"),
        v if v < 999.5e9 => (1e9, "G"),
        _ => (1e12, "T"),
    };
    format!("{} {unit}", human_number(value / scale))
}

pub(super) fn human_seconds(seconds: f64) -> String {
    match seconds {
        s if s <= 0.0 => "0 s".to_owned(),
        s if s < 0.0995 => format!("{:.1} ms", s * 1e3),
        s if s < 0.9995 => format!("{:.0} ms", s * 1e3),
        s if s < 9.995 => format!("{s:.2} s"),
        s if s < 59.95 => format!("{s:.1} s"),
        s if s < 3600.0 => format!("{:.0} min {:02.0} s", (s / 60.0).floor(), (s % 60.0).floor()),
        s if s < 86_400.0 => format!("{:.0} h {:02.0} min", (s / 3600.0).floor(), (s % 3600.0 / 60.0).floor()),
        s => format!("{:.0} d {:02.0} h", (s / 86_400.0).floor(), (s % 86_400.0 / 3600.0).floor()),
    }
}

pub(super) fn human_number(value: f64) -> String {
    let magnitude = value.abs();
    let decimals = match magnitude {
        m if m == 0.0 || m >= 100.0 => 0,
        m if m >= 10.0 => 1,
        m if m >= 1.0 => 2,
        m => (2.0 - m.log10().floor()).clamp(2.0, 9.0) as usize,
    };
    if magnitude >= 1000.0 {
        return human_count(value);
    }
    let text = format!("{value:.decimals$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

pub(super) fn human_ago(then: Timestamp, now: Timestamp) -> String {
    let seconds = now.since((Unit::Second, then)).map_or(0, |span| span.get_seconds());
    match seconds {
        i64::MIN..=4 => "just now".to_owned(),
        5..=59 => format!("{seconds} s ago"),
        60..=3599 => format!("{} min ago", seconds / 60),
        3600..=86_399 => format!("{} h ago", seconds / 3600),
        _ => format!("{} d ago", seconds / 86_400),
    }
}

pub(super) fn human_words(name: &str) -> String {
    let spaced = name.replace('_', " ");
    match name {
        "bvh" | "ao" | "aov" => return name.to_uppercase(),
        "ntree" => return "N-tree".to_owned(),
        _ => {}
    }
    let mut characters = spaced.chars();
    match characters.next() {
        Some(first) => first.to_uppercase().chain(characters).collect(),
        None => spaced,
    }
}

/// A description in the little Markdown that API comments use, as HTML: paragraphs, `code` and link texts.
#[askama::filter_fn]
pub(super) fn prose(value: impl AsRef<str>, _: &dyn Values) -> askama::Result<Safe<String>> {
    Ok(Safe(prose_html(value.as_ref())))
}

pub(super) fn prose_html(text: &str) -> String {
    let mut html = String::with_capacity(text.len() + 16);
    for paragraph in text.split("\n\n").map(str::trim).filter(|paragraph| !paragraph.is_empty()) {
        html.push_str("<p>");
        for (index, piece) in link_texts(paragraph).split('`').enumerate() {
            let code = index % 2 == 1;
            html.push_str(if code { "<code>" } else { "" });
            escape_html(piece, &mut html);
            html.push_str(if code { "</code>" } else { "" });
        }
        html.push_str("</p>");
    }
    html
}

/// `[text](target)` and `[text]` as `text`: the targets are Rust paths, which lead nowhere here.
fn link_texts(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.find("[`") {
        let Some(length) = rest[start..].find("`]") else { break };
        plain.push_str(&rest[..start]);
        plain.push_str(&rest[start + 1..=start + length]);
        rest = &rest[start + length + 2..];
        if rest.starts_with('(')
            && let Some(end) = rest.find(')')
        {
            rest = &rest[end + 1..];
        }
    }
    plain + rest
}

fn escape_html(text: &str, html: &mut String) {
    for character in text.chars() {
        match character {
            '&' => html.push_str("&amp;"),
            '<' => html.push_str("&lt;"),
            '>' => html.push_str("&gt;"),
            '"' => html.push_str("&quot;"),
            '\'' => html.push_str("&#39;"),
            other => html.push(other),
        }
    }
}
