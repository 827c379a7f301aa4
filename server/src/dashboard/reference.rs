//! `/docs`: reference of the JSON API, made from `/openapi.json` on every request, so that it never lags behind.

use askama::Template;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value};

use super::client::Api;
use super::filters;
use super::overview::base_url;
use super::page::{Page, PageError};
use super::schema::{SchemaDoc, TypeName, example, pretty, text_of};
use crate::problems::Code;

#[derive(Template)]
#[template(path = "reference.html")]
struct Reference {
    here: &'static str,
    title: String,
    version: String,
    description: String,
    tags: Vec<Tag>,
    problems: [Code; Code::ALL.len()],
    schemas: Vec<SchemaDoc>,
    base_url: String,
}

struct Tag {
    name: String,
    description: String,
    operations: Vec<Operation>,
}

struct Operation {
    /// Operation id: unique, and the anchor.
    id: String,
    method: String,
    path: String,
    summary: String,
    description: String,
    parameters: Vec<Parameter>,
    bodies: Vec<Body>,
    responses: Vec<Answer>,
    curl: String,
}

struct Parameter {
    name: String,
    place: String,
    required: bool,
    kind: TypeName,
    description: String,
}

struct Body {
    media_type: String,
    kind: TypeName,
}

struct Answer {
    status: String,
    description: String,
    bodies: Vec<Body>,
}

pub(super) async fn show(api: Api, headers: HeaderMap) -> Result<Response, PageError> {
    let document: Value = api.get("/openapi.json").await?;
    Ok(Page(Reference::new(&document, base_url(&headers))).into_response())
}

impl Reference {
    fn new(document: &Value, base_url: String) -> Self {
        let none = Map::new();
        let schemas = document.pointer("/components/schemas").and_then(Value::as_object).unwrap_or(&none);
        let info = &document["info"];
        Self {
            here: "docs",
            title: text_of(info, "title"),
            version: text_of(info, "version"),
            description: text_of(info, "description"),
            tags: tags(document, schemas, &base_url),
            problems: Code::ALL,
            schemas: schemas.keys().map(|name| SchemaDoc::new(name, schemas)).collect(),
            base_url,
        }
    }
}

/// Operations by their first tag: the document's own order of tags first, then any others.
fn tags(document: &Value, schemas: &Map<String, Value>, base_url: &str) -> Vec<Tag> {
    let described = document.get("tags").and_then(Value::as_array).into_iter().flatten();
    let mut tags: Vec<Tag> = described
        .map(|tag| Tag { name: text_of(tag, "name"), description: text_of(tag, "description"), operations: Vec::new() })
        .collect();
    for (path, item) in document.get("paths").and_then(Value::as_object).into_iter().flatten() {
        for (method, operation) in item.as_object().into_iter().flatten() {
            if !matches!(method.as_str(), "get" | "put" | "post" | "delete" | "patch" | "head") {
                continue;
            }
            let name = operation.pointer("/tags/0").and_then(Value::as_str).unwrap_or("other");
            let operation = Operation::new(method, path, operation, item, schemas, base_url);
            match tags.iter_mut().find(|tag| tag.name == name) {
                Some(tag) => tag.operations.push(operation),
                None => {
                    tags.push(Tag { name: name.to_owned(), description: String::new(), operations: vec![operation] })
                }
            }
        }
    }
    tags.retain(|tag| !tag.operations.is_empty());
    tags
}

impl Operation {
    fn new(
        method: &str,
        path: &str,
        operation: &Value,
        item: &Value,
        schemas: &Map<String, Value>,
        base_url: &str,
    ) -> Self {
        let shared = item.get("parameters").and_then(Value::as_array).into_iter().flatten();
        let own = operation.get("parameters").and_then(Value::as_array).into_iter().flatten();
        let parameters: Vec<_> = shared.chain(own).map(Parameter::new).collect();
        let id = match text_of(operation, "operationId") {
            id if id.is_empty() => format!("{method}{}", path.replace(['/', '{', '}'], "-")),
            id => id,
        };
        let content = operation.pointer("/requestBody/content");
        let responses = operation.get("responses").and_then(Value::as_object);
        Self {
            curl: curl(method, path, &parameters, content, schemas, base_url),
            method: method.to_uppercase(),
            path: path.to_owned(),
            id,
            summary: text_of(operation, "summary"),
            description: text_of(operation, "description"),
            parameters,
            bodies: bodies(content),
            responses: responses.into_iter().flatten().map(|(status, answer)| Answer::new(status, answer)).collect(),
        }
    }
}

impl Parameter {
    fn new(parameter: &Value) -> Self {
        Self {
            name: text_of(parameter, "name"),
            place: text_of(parameter, "in"),
            required: parameter.get("required").and_then(Value::as_bool).unwrap_or(false),
            kind: parameter.get("schema").map(TypeName::of).unwrap_or_default(),
            description: text_of(parameter, "description"),
        }
    }
}

impl Answer {
    fn new(status: &str, answer: &Value) -> Self {
        Self {
            status: status.to_owned(),
            description: text_of(answer, "description"),
            bodies: bodies(answer.get("content")),
        }
    }
}

fn bodies(content: Option<&Value>) -> Vec<Body> {
    let types = content.and_then(Value::as_object).into_iter().flatten();
    types
        .map(|(media_type, body)| Body {
            media_type: media_type.clone(),
            kind: body.get("schema").map(TypeName::of).unwrap_or_default(),
        })
        .collect()
}

/// A command that makes the request, with `$NAME` for what the reader fills in.
fn curl(
    method: &str,
    path: &str,
    parameters: &[Parameter],
    content: Option<&Value>,
    schemas: &Map<String, Value>,
    base_url: &str,
) -> String {
    let mut address = format!("{base_url}{path}");
    for parameter in parameters.iter().filter(|parameter| parameter.place == "path") {
        let variable = format!("${}", parameter.name.to_uppercase());
        address = address.replace(&format!("{{{}}}", parameter.name), &variable);
    }
    let mut command = String::from("curl");
    if method != "get" {
        command.push_str(&format!(" -X {}", method.to_uppercase()));
    }
    command.push_str(&format!(" \"{address}\""));
    let Some(types) = content.and_then(Value::as_object) else { return command };
    if let Some(body) = types.get("application/json") {
        let value = body.get("example").cloned();
        let value = value.or_else(|| body.get("schema").map(|schema| example(schema, schemas))).unwrap_or_default();
        let text = pretty(&value).replace('\'', "'\\''");
        command.push_str(&format!(" \\\n  -H 'Content-Type: application/json' \\\n  -d '{text}'"));
    } else if let Some(media_type) = types.keys().next() {
        match media_type.as_str() {
            "multipart/form-data" => command.push_str(" \\\n  -F file=@FILE"),
            other => command.push_str(&format!(" \\\n  -H 'Content-Type: {other}' \\\n  --data-binary @FILE")),
        }
    }
    command
}

/// Name of the table for one of several forms of a schema.
fn form_label(schema: &str, number: &usize) -> String {
    format!("{schema}, form {number}")
}
