//! Names and patterns of a request: few and short enough that looking for them costs nothing to speak of. Asked where a
//! request is accepted; what was accepted once is read again whatever the limits are.

use rebake_core::allowed::Allowed;

use super::edit_parse::Parsed;
use super::edit_types::{EditOp, Hide, Remove, Show};
use super::misread::join;
use super::problem::{ApiResult, Kind, Problem};

/// Names of objects in all edits of a request.
pub(super) const MAX_NAMES: usize = 4096;
/// Those with a `*`: each is held against every object.
const MAX_PATTERNS: usize = 64;

/// Refuses lists of names that would take long to look for. No name of an object is longer than what
/// [`Allowed`] names have, so that no longer one is of use.
pub(super) fn check_names(parsed: &Parsed) -> ApiResult<()> {
    let max_chars = Allowed::ASKED.name_chars;
    let invalid = |field: String, reason: String| Err(Problem::field(Kind::InvalidValue, field, reason));
    let (mut names, mut patterns) = (0, 0);
    for (i, op) in parsed.edits.iter().enumerate() {
        let (EditOp::Remove(Remove { objects }) | EditOp::Hide(Hide { objects }) | EditOp::Show(Show { objects })) = op
        else {
            continue;
        };
        let field = join(&parsed.path(i), "objects");
        names += objects.len();
        if names > MAX_NAMES {
            return invalid(field, format!("a request may hold {MAX_NAMES} names of objects"));
        }
        for (k, name) in objects.iter().enumerate() {
            if name.chars().nth(max_chars).is_some() {
                return invalid(format!("{field}[{k}]"), format!("may have {max_chars} characters"));
            }
            patterns += usize::from(name.contains('*'));
        }
        if patterns > MAX_PATTERNS {
            return invalid(field, format!("a request may hold {MAX_PATTERNS} names with a `*`"));
        }
    }
    Ok(())
}
