//! Pages of lists.

use axum::Json;
use lightshaft_api::page::Page;

/// A page of rows, of which one more than wanted was asked for, to know whether there is a next page.
pub fn page<T>(mut items: Vec<T>, asked: u32, id: impl Fn(&T) -> &String) -> Json<Page<T>> {
    let wanted = asked.saturating_sub(1) as usize;
    let has_more = items.len() > wanted;
    items.truncate(wanted);
    let next_cursor = items.last().filter(|_| has_more).map(|item| id(item).clone());
    Json(Page { items, next_cursor })
}
