//! A seam for tests: every step that writes to the data directory asks first.

use std::fmt;
use std::io;
use std::sync::Arc;

/// One step of writing. The service may be killed between any two of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum WriteStep {
    /// A temporary file is created.
    Create,
    /// Its bytes are written; a fault leaves half of them.
    Write,
    /// They are forced to the disk.
    Sync,
    /// The file gets its name.
    Rename,
    /// The name is forced to the disk.
    SyncDirectory,
    /// A database transaction begins.
    Begin,
    /// A database transaction is committed.
    Commit,
}

type Probe = dyn Fn(WriteStep) -> io::Result<()> + Send + Sync;

/// Asked before every [`WriteStep`]: an error stands for the disk's own. Lets everything pass unless a test says
/// otherwise.
#[derive(Clone, Default)]
pub struct Faults(Option<Arc<Probe>>);

impl Faults {
    /// Asks `probe` before every step.
    pub fn new(probe: impl Fn(WriteStep) -> io::Result<()> + Send + Sync + 'static) -> Faults {
        Faults(Some(Arc::new(probe)))
    }

    pub(crate) fn check(&self, step: WriteStep) -> io::Result<()> {
        self.0.as_ref().map_or(Ok(()), |probe| probe(step))
    }
}

impl fmt::Debug for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() { "Faults(injected)" } else { "Faults(none)" })
    }
}
