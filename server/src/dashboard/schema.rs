//! Schemas of an OpenAPI 3.1 document in words: the name of a type, its fields, an example.

use serde_json::{Map, Value, json};

/// A type in a sentence: pieces of text, some of which link to a schema.
#[derive(Debug, Default, PartialEq)]
pub(super) struct TypeName {
    pub(super) pieces: Vec<Piece>,
}

#[derive(Debug, PartialEq)]
pub(super) struct Piece {
    pub(super) text: String,
    /// Name of the schema that the text is a link to.
    pub(super) schema: Option<String>,
}

impl TypeName {
    fn text(text: impl Into<String>) -> Self {
        Self { pieces: vec![Piece { text: text.into(), schema: None }] }
    }

    fn before(mut self, text: &str) -> Self {
        self.pieces.insert(0, Piece { text: text.to_owned(), schema: None });
        self
    }

    fn or(mut self, other: Self) -> Self {
        self.pieces.push(Piece { text: " or ".to_owned(), schema: None });
        self.pieces.extend(other.pieces);
        self
    }

    /// The type that `schema` describes.
    pub(super) fn of(schema: &Value) -> Self {
        if let Some(name) = reference(schema) {
            return Self { pieces: vec![Piece { text: name.to_owned(), schema: Some(name.to_owned()) }] };
        }
        if let Some(value) = schema.get("const") {
            return Self::text(value.to_string());
        }
        for keyword in ["oneOf", "anyOf"] {
            if let Some(variants) = schema.get(keyword).and_then(Value::as_array) {
                return alternatives(variants.iter().map(Self::of));
            }
        }
        if let Some(parts) = schema.get("allOf").and_then(Value::as_array)
            && let [only] = parts.as_slice()
        {
            return Self::of(only);
        }
        match schema.get("type") {
            Some(Value::Array(types)) => alternatives(types.iter().map(|name| {
                let mut one = schema.clone();
                one["type"] = name.clone();
                Self::of(&one)
            })),
            Some(Value::String(name)) => Self::of_type(name, schema),
            _ if schema.get("properties").is_some() || schema.get("allOf").is_some() => Self::text("object"),
            _ => Self::text("any JSON value"),
        }
    }

    fn of_type(name: &str, schema: &Value) -> Self {
        match name {
            "array" => match schema.get("items") {
                Some(items) if items.is_object() => Self::of(items).before("list of "),
                _ => Self::text("list"),
            },
            "object" => match schema.get("additionalProperties") {
                Some(values) if values.is_object() => Self::of(values).before("map of text to "),
                _ => Self::text("object"),
            },
            "string" => match schema.get("enum").and_then(Value::as_array) {
                Some(values) => Self::text(values.iter().map(Value::to_string).collect::<Vec<_>>().join(" or ")),
                None => match schema.get("format").and_then(Value::as_str) {
                    Some("date-time") => Self::text("time (RFC 3339)"),
                    Some("binary") => Self::text("bytes"),
                    _ => Self::text("text"),
                },
            },
            "integer" => Self::text("whole number"),
            "boolean" => Self::text("true or false"),
            other => Self::text(other),
        }
    }
}

fn alternatives(types: impl Iterator<Item = TypeName>) -> TypeName {
    types.reduce(TypeName::or).unwrap_or_else(|| TypeName::text("nothing"))
}

/// Name of the component schema that `schema` refers to.
pub(super) fn reference(schema: &Value) -> Option<&str> {
    schema.get("$ref")?.as_str()?.strip_prefix("#/components/schemas/")
}

pub(super) fn text_of(value: &Value, key: &str) -> String {
    value.get(key).and_then(Value::as_str).unwrap_or_default().to_owned()
}

/// One field of an object.
pub(super) struct FieldDoc {
    pub(super) name: String,
    pub(super) kind: TypeName,
    pub(super) required: bool,
    pub(super) default: Option<String>,
    pub(super) description: String,
}

/// One of several forms that a value may have.
pub(super) struct VariantDoc {
    pub(super) kind: TypeName,
    pub(super) description: String,
    pub(super) fields: Vec<FieldDoc>,
}

/// A named schema.
pub(super) struct SchemaDoc {
    pub(super) name: String,
    pub(super) kind: TypeName,
    pub(super) description: String,
    pub(super) fields: Vec<FieldDoc>,
    pub(super) variants: Vec<VariantDoc>,
    pub(super) example: String,
}

impl SchemaDoc {
    pub(super) fn new(name: &str, schemas: &Map<String, Value>) -> Self {
        let schema = &schemas[name];
        let variants = ["oneOf", "anyOf"].into_iter().find_map(|keyword| schema.get(keyword)?.as_array());
        let variant = |schema: &Value| VariantDoc {
            kind: TypeName::of(schema),
            description: text_of(schema, "description"),
            fields: fields_of(schema, schemas),
        };
        Self {
            name: name.to_owned(),
            kind: TypeName::of(schema),
            description: text_of(schema, "description"),
            fields: fields_of(schema, schemas),
            variants: variants.into_iter().flatten().map(variant).collect(),
            example: pretty(&example(schema, schemas)),
        }
    }
}

/// Own fields, and those of everything that `allOf` adds.
fn fields_of(schema: &Value, schemas: &Map<String, Value>) -> Vec<FieldDoc> {
    let mut fields = Vec::new();
    for part in schema.get("allOf").and_then(Value::as_array).into_iter().flatten() {
        let resolved = reference(part).and_then(|name| schemas.get(name)).unwrap_or(part);
        fields.extend(fields_of(resolved, schemas));
    }
    let required = schema.get("required").and_then(Value::as_array);
    let is_required = |name: &str| required.is_some_and(|names| names.iter().any(|known| known == name));
    for (name, field) in schema.get("properties").and_then(Value::as_object).into_iter().flatten() {
        fields.push(FieldDoc {
            name: name.clone(),
            kind: TypeName::of(field),
            required: is_required(name),
            default: field.get("default").map(Value::to_string),
            description: text_of(field, "description"),
        });
    }
    fields
}

/// Nesting below which an example stops: schemas may refer to themselves.
const MAX_EXAMPLE_DEPTH: usize = 6;

/// The document's own example, or a value of the right shape.
pub(super) fn example(schema: &Value, schemas: &Map<String, Value>) -> Value {
    example_at(schema, schemas, 0)
}

fn example_at(schema: &Value, schemas: &Map<String, Value>, depth: usize) -> Value {
    for keyword in ["example", "default", "const"] {
        if let Some(value) = schema.get(keyword) {
            return value.clone();
        }
    }
    if let Some(first) = ["examples", "enum"].iter().find_map(|k| schema.get(k)?.as_array()?.first()) {
        return first.clone();
    }
    if depth > MAX_EXAMPLE_DEPTH {
        return Value::Null;
    }
    if let Some(target) = reference(schema).and_then(|name| schemas.get(name)) {
        return example_at(target, schemas, depth + 1);
    }
    for keyword in ["oneOf", "anyOf"] {
        if let Some(variants) = schema.get(keyword).and_then(Value::as_array) {
            let not_null = variants.iter().find(|variant| variant.get("type") != Some(&json!("null")));
            return not_null.map_or(Value::Null, |variant| example_at(variant, schemas, depth + 1));
        }
    }
    let mut object = Map::new();
    for part in schema.get("allOf").and_then(Value::as_array).into_iter().flatten() {
        if let Value::Object(fields) = example_at(part, schemas, depth + 1) {
            object.extend(fields);
        }
    }
    for (name, field) in schema.get("properties").and_then(Value::as_object).into_iter().flatten() {
        object.insert(name.clone(), example_at(field, schemas, depth + 1));
    }
    if !object.is_empty() {
        return Value::Object(object);
    }
    let name = match schema.get("type") {
        Some(Value::Array(types)) => types.iter().find(|name| *name != "null").and_then(Value::as_str),
        other => other.and_then(Value::as_str),
    };
    match name {
        Some("string") if schema.get("format") == Some(&json!("date-time")) => json!("2026-01-31T12:00:00Z"),
        Some("string") => json!("text"),
        Some("integer") => schema.get("minimum").cloned().unwrap_or(json!(1)),
        Some("number") => json!(1.0),
        Some("boolean") => json!(false),
        Some("array") => array_example(schema, schemas, depth),
        Some("object") => json!({}),
        _ => Value::Null,
    }
}

fn array_example(schema: &Value, schemas: &Map<String, Value>, depth: usize) -> Value {
    let one = match schema.get("items") {
        Some(items) if items.is_object() => example_at(items, schemas, depth + 1),
        _ => return json!([]),
    };
    let count = schema.get("minItems").and_then(Value::as_u64).unwrap_or(1).clamp(1, 4);
    Value::Array((0..count).map(|_| one.clone()).collect())
}

pub(super) fn pretty(value: &Value) -> String {
    serde_json::to_string_pretty(value).unwrap_or_default()
}
