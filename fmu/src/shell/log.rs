//! Log lines for the host.

use std::ffi::{CStr, CString};

use crate::types::Status;

/// What hosts can switch on and off, as declared in `modelDescription.xml`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Category {
    Events,
    Warning,
    Discard,
    Error,
    Fatal,
}

pub const CATEGORIES: [(Category, &CStr); 5] = [
    (Category::Events, c"logEvents"),
    (Category::Warning, c"logStatusWarning"),
    (Category::Discard, c"logStatusDiscard"),
    (Category::Error, c"logStatusError"),
    (Category::Fatal, c"logStatusFatal"),
];

impl Category {
    pub fn of(status: Status) -> Category {
        match status {
            Status::Ok => Category::Events,
            Status::Warning => Category::Warning,
            Status::Discard => Category::Discard,
            Status::Error => Category::Error,
            Status::Fatal => Category::Fatal,
        }
    }
}

/// Hands status, category and format string to the host.
pub type Sink = Box<dyn Fn(Status, &CStr, &CStr)>;

/// A line's category follows from its status.
pub struct Logger {
    /// None where the host gave no callback.
    sink: Option<Sink>,
    enabled: [bool; CATEGORIES.len()],
}

impl Logger {
    /// `loggingOn` of `fmi2Instantiate` switches the events; what goes wrong is logged until
    /// [`Logger::switch`] says otherwise.
    pub fn new(sink: Option<Sink>, logging_on: bool) -> Logger {
        let mut enabled = [true; CATEGORIES.len()];
        enabled[Category::Events as usize] = logging_on;
        Logger { sink, enabled }
    }

    /// `fmi2SetDebugLogging`. No categories: all. On: those named and no others; off: those named go
    /// off. The error names an unknown category; then nothing has changed.
    pub fn switch(&mut self, on: bool, names: &[&CStr]) -> Result<(), String> {
        if names.is_empty() {
            self.enabled = [on; CATEGORIES.len()];
            return Ok(());
        }
        let mut enabled = if on {
            [false; CATEGORIES.len()]
        } else {
            self.enabled
        };
        for name in names {
            match CATEGORIES.iter().position(|(_, known)| known == name) {
                Some(k) => enabled[k] = on,
                None => {
                    let known = CATEGORIES.map(|(_, name)| name.to_string_lossy().into_owned());
                    return Err(format!(
                        "there is no log category {:?}; there are {}",
                        name.to_string_lossy(),
                        known.join(", ")
                    ));
                }
            }
        }
        self.enabled = enabled;
        Ok(())
    }

    /// Whether a line of this status would reach the host.
    pub fn wants(&self, status: Status) -> bool {
        self.sink.is_some() && self.enabled[Category::of(status) as usize]
    }

    pub fn log(&self, status: Status, message: &str) {
        let Some(sink) = self.sink.as_ref().filter(|_| self.wants(status)) else {
            return;
        };
        let category = CATEGORIES[Category::of(status) as usize].1;
        sink(status, category, &as_format(message));
    }
}

/// Hosts hand the message to printf: `%` is written `%%`.
fn as_format(message: &str) -> CString {
    let text = message.replace('%', "%%").replace('\0', "\u{fffd}");
    CString::new(text).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;
    use std::rc::Rc;

    fn recorder() -> (Rc<RefCell<Vec<String>>>, Option<Sink>) {
        let lines = Rc::new(RefCell::new(Vec::new()));
        let into = lines.clone();
        let sink: Sink = Box::new(move |status, category, message| {
            let (category, message) = (category.to_string_lossy(), message.to_string_lossy());
            into.borrow_mut()
                .push(format!("{} {category} {message}", status.code()));
        });
        (lines, Some(sink))
    }

    #[test]
    fn percent_is_escaped_and_nul_cannot_cut_a_line() {
        let (lines, sink) = recorder();
        Logger::new(sink, true).log(Status::Error, "100 %s\0 done");
        assert_eq!(
            *lines.borrow(),
            ["3 logStatusError 100 %%s\u{fffd} done".to_string()]
        );
    }

    #[test]
    fn categories_are_switched() {
        let (lines, sink) = recorder();
        let mut logger = Logger::new(sink, false);
        logger.log(Status::Ok, "hidden");
        logger.log(Status::Warning, "a");
        logger.switch(true, &[c"logEvents"]).unwrap();
        logger.log(Status::Warning, "hidden");
        logger.log(Status::Ok, "b");
        logger.switch(true, &[]).unwrap();
        logger.switch(false, &[c"logEvents"]).unwrap();
        logger.log(Status::Ok, "hidden");
        logger.log(Status::Fatal, "c");
        assert!(logger.switch(true, &[c"logEvents", c"x"]).is_err());
        logger.log(Status::Error, "d");
        logger.switch(false, &[]).unwrap();
        logger.log(Status::Error, "hidden");
        let seen: Vec<char> = lines
            .borrow()
            .iter()
            .filter_map(|l| l.chars().last())
            .collect();
        assert_eq!(seen, ['a', 'b', 'c', 'd']);
    }

    #[test]
    fn no_callback_is_fine() {
        Logger::new(None, true).log(Status::Error, "x");
    }
}
