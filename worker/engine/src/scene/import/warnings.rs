//! What was skipped or repaired, told in the file's own terms.

/// More than these would only fill pages: the rest is counted.
const MOST: usize = 100;

#[derive(Debug, Default)]
pub(super) struct Warnings {
    messages: Vec<String>,
    more: usize,
}

impl Warnings {
    pub(super) fn add(&mut self, position: &str, message: impl AsRef<str>) {
        if self.messages.len() == MOST {
            self.more += 1;
            return;
        }
        let separator = if position.is_empty() { "" } else { ": " };
        let message = format!("{position}{separator}{}", message.as_ref());
        // Several poses of one mesh have the same to say.
        if !self.messages.contains(&message) {
            self.messages.push(message);
        }
    }

    pub(super) fn append(&mut self, other: Self) {
        for message in other.messages {
            self.add("", message);
        }
        self.more += other.more;
    }

    pub(super) fn into_messages(mut self) -> Vec<String> {
        if self.more > 0 {
            self.messages.push(format!("and {} more", self.more));
        }
        self.messages
    }
}
