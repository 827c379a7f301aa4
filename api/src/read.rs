//! Reading JSON so that every wrong field is named, not only the first.

use serde::de::DeserializeOwned;
use serde_json::Value;
use serde_path_to_error::{Path, Segment};

use crate::problem::{FieldError, escape_pointer};

/// Wrong fields that one answer names at most.
const MOST_ERRORS: usize = 32;

/// Reads an object, or names every field that is unknown, missing or of a wrong type. What was found wrong is left out
/// and the rest read again, until nothing new is found.
///
/// # Errors
/// One per wrong field, with its JSON pointer below `value`, and what would be right.
pub fn from_value<T: DeserializeOwned>(mut value: Value) -> Result<T, Vec<FieldError>> {
    if !value.is_object() {
        return Err(vec![FieldError::new("", format!("must be a JSON object, not {}", kind_of(&value)))]);
    }
    let mut errors: Vec<FieldError> = Vec::new();
    let mut left_out: Vec<String> = Vec::new();
    loop {
        match serde_path_to_error::deserialize::<_, T>(&value) {
            Ok(read) if errors.is_empty() => return Ok(read),
            Ok(_) => return Err(errors),
            Err(error) => {
                let found = field_error(&pointer(error.path()), &error.inner().to_string());
                let removed = remove(&mut value, &found.pointer);
                // What was left out here is missing now, which is no mistake of the sender's.
                let is_known = errors.iter().any(|known| known.pointer == found.pointer);
                if !is_known && !left_out.contains(&found.pointer) {
                    errors.push(found);
                }
                match removed {
                    Some(pointer) if errors.len() < MOST_ERRORS => left_out.push(pointer),
                    _ => return Err(errors),
                }
            }
        }
    }
}

fn kind_of(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a boolean",
        Value::Number(_) => "a number",
        Value::String(_) => "a string",
        Value::Array(_) => "an array",
        Value::Object(_) => "an object",
    }
}

/// Removes the field at `pointer`, or the innermost field around it that there is; returns that one's pointer.
fn remove(value: &mut Value, pointer: &str) -> Option<String> {
    let mut end = pointer.len();
    while let Some(slash) = pointer[..end].rfind('/') {
        let key = pointer[slash + 1..end].replace("~1", "/").replace("~0", "~");
        let parent = value.pointer_mut(&pointer[..slash]).and_then(Value::as_object_mut);
        if parent.is_some_and(|object| object.remove(&key).is_some()) {
            return Some(pointer[..end].to_owned());
        }
        end = slash;
    }
    None
}

fn pointer(path: &Path) -> String {
    let mut pointer = String::new();
    for segment in path {
        match segment {
            Segment::Seq { index } => pointer.push_str(&format!("/{index}")),
            Segment::Map { key } => pointer.push_str(&format!("/{}", escape_pointer(key))),
            Segment::Enum { .. } | Segment::Unknown => {}
        }
    }
    pointer
}

/// serde reports an unknown or missing field at the object that lacks or holds it; the pointer goes to the field.
fn field_error(path: &str, message: &str) -> FieldError {
    let mut pointer = path.to_owned();
    for prefix in ["unknown field `", "missing field `"] {
        let field = message.strip_prefix(prefix).and_then(|rest| rest.split('`').next());
        if let Some(field) = field {
            let token = format!("/{}", escape_pointer(field));
            if !pointer.ends_with(&token) {
                pointer.push_str(&token);
            }
        }
    }
    FieldError::new(pointer, message)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::job::NewJob;

    fn errors(value: Value) -> Vec<(String, String)> {
        let errors = from_value::<NewJob>(value).unwrap_err();
        errors.into_iter().map(|error| (error.pointer, error.detail)).collect()
    }

    fn pointers(value: Value) -> Vec<String> {
        errors(value).into_iter().map(|(pointer, _)| pointer).collect()
    }

    #[test]
    fn a_wrong_field_is_named_with_its_place() {
        assert_eq!(pointers(json!({ "scene": "x", "settings": { "widht": 5 } })), ["/settings/widht"]);
        assert_eq!(pointers(json!({ "scene": "x", "settings": { "width": -1 } })), ["/settings/width"]);
        assert_eq!(pointers(json!({ "settings": {} })), ["/scene"]);
        assert_eq!(
            pointers(json!({ "scene": "x", "settings": { "lights": [{ "kind": "point", "colour": 1 }] } }))[0],
            "/settings/lights/0/colour"
        );
        assert_eq!(
            pointers(json!({ "scene": "x", "settings": { "camera": { "positon": [0, 0, 0] } } }))[0],
            "/settings/camera/positon"
        );
    }

    #[test]
    fn every_wrong_field_is_named_at_once() {
        let mut named = pointers(json!({
            "scene": 5, "foo": 1, "a/b": 2,
            "settings": { "width": "wide", "integrator": "magic", "sppp": 4, "outputs": ["jpg"], "spp": 4 },
        }));
        named.sort();
        let expected = ["/a~1b", "/foo", "/scene", "/settings/integrator", "/settings/outputs/0", "/settings/sppp"];
        assert_eq!(named[..6], expected);
        assert_eq!(named[6..], ["/settings/width"]);
    }

    #[test]
    fn an_unknown_value_comes_with_those_allowed() {
        let errors = errors(json!({ "scene": "x", "settings": { "integrator": "magic" } }));
        assert_eq!(errors.len(), 1);
        for allowed in ["aov", "ao", "direct", "whitted", "path"] {
            assert!(errors[0].1.contains(&format!("`{allowed}`")), "{errors:?}");
        }
    }

    #[test]
    fn only_an_object_is_read() {
        assert_eq!(errors(json!([1, 2])), [(String::new(), "must be a JSON object, not an array".to_owned())]);
        assert_eq!(errors(json!("x"))[0].0, "");
    }

    #[test]
    fn endless_errors_are_cut() {
        let many = (0..100).map(|i| (format!("f{i}"), json!(i))).collect::<serde_json::Map<_, _>>();
        assert_eq!(pointers(Value::Object(many)).len(), MOST_ERRORS);
    }
}
