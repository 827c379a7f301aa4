//! Why a command ended badly, and the exit code that says so.

use lightshaft_api::client::ClientError;
use lightshaft_api::problem::FieldError;

use super::output;

#[derive(Debug)]
pub(crate) struct CliError {
    code: u8,
    message: String,
}

pub(crate) type Result<T> = std::result::Result<T, CliError>;

impl CliError {
    /// The answer is no: a failed job, a comparison over its limit.
    pub(crate) fn no(message: impl Into<String>) -> Self {
        Self { code: 1, message: message.into() }
    }

    /// Wrong usage or input.
    pub(crate) fn usage(message: impl Into<String>) -> Self {
        Self { code: 2, message: message.into() }
    }

    /// Wrong fields, each by its name below `prefix`.
    pub(crate) fn fields(errors: &[FieldError], prefix: &str) -> Self {
        let named = |error: &FieldError| {
            let name = error.pointer.strip_prefix(prefix).unwrap_or(&error.pointer);
            format!("{name}: {}", error.detail)
        };
        Self::usage(output::printable(&errors.iter().map(named).collect::<Vec<_>>().join("; ")))
    }

    /// The service or the system failed.
    pub(crate) fn system(message: impl Into<String>) -> Self {
        Self { code: 3, message: message.into() }
    }

    /// The same, and what it is about.
    pub(crate) fn below(self, what: &str) -> Self {
        Self { message: format!("{what}: {}", self.message), ..self }
    }

    pub(crate) fn code(&self) -> u8 {
        self.code
    }

    pub(crate) fn print(&self) {
        eprintln!("error: {}", self.message);
    }
}

impl From<ClientError> for CliError {
    fn from(error: ClientError) -> Self {
        let message = error.to_string();
        match &error {
            ClientError::Address { .. } | ClientError::File { .. } => Self::usage(message),
            ClientError::Problem { problem, .. } if (400..500).contains(&problem.status) && !error.is_transient() => {
                Self::usage(message)
            }
            ClientError::Transport { source, .. } => Self::system(format!("{message}{}", causes(source))),
            ClientError::Problem { .. } | ClientError::Unexpected { .. } | ClientError::Stalled { .. } => {
                Self::system(message)
            }
        }
    }
}

/// The chain of causes, such as `: connection refused`, without those that repeat what was said.
fn causes(error: &dyn std::error::Error) -> String {
    let mut text = String::new();
    let mut said = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let message = error.to_string();
        if !said.contains(&message) {
            text.push_str(": ");
            text.push_str(&message);
            said = message;
        }
        cause = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use lightshaft_api::problem::Problem;

    #[test]
    fn exit_codes_tell_the_users_mistakes_from_the_services() {
        let code = |status: u16| {
            let problem = Problem {
                kind: "/problems/x".into(),
                code: "x".into(),
                title: "t".into(),
                status,
                detail: "d".into(),
                errors: vec![],
                instance: None,
                request_id: None,
            };
            CliError::from(ClientError::Problem { problem: Box::new(problem), retry_after: None }).code()
        };
        assert_eq!([400, 404, 422].map(code), [2, 2, 2]);
        assert_eq!([429, 500, 503].map(code), [3, 3, 3]);
        let address = ClientError::Address { url: "x".into(), detail: "y".into() };
        assert_eq!(CliError::from(address).code(), 2);
    }
}
