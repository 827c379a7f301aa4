//! Names and remarks that people give.

use crate::problem::FieldError;

/// A name: 1 to `most` characters, none of them a control character, and not blank.
pub fn check_name(name: &str, most: usize, pointer: &str) -> Option<FieldError> {
    let length = name.chars().count();
    if name.trim().is_empty() || length > most || name.chars().any(char::is_control) {
        return Some(FieldError::new(
            pointer,
            format!("must have 1 to {most} characters, in one line, and not be blank"),
        ));
    }
    None
}

/// A remark: at most `most` characters; lines are welcome.
pub fn check_text(text: &str, most: usize, pointer: &str) -> Option<FieldError> {
    (text.chars().count() > most).then(|| FieldError::new(pointer, format!("must have at most {most} characters")))
}
