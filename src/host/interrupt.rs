//! The end by a signal.

use super::temporary;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;

/// From now on, Ctrl-C and the signals to end remove what the program has begun to write before they
/// end it. A signal that the program was started to ignore stays ignored.
///
/// For a program's main function; a library leaves signals to the program that it is in.
pub fn remove_unfinished_on_signals() -> std::io::Result<()> {
    let heeded = [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|&signal| !is_ignored(signal));
    let mut signals = Signals::new(heeded)?;
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        if let Some(signal) = signals.forever().next() {
            let _nothing_is_begun_any_more = temporary::abandon();
            // It ends the process as if nobody had heeded the signal, which the shell can tell.
            let _ = emulate_default_handler(signal);
        }
    })?;
    Ok(())
}

/// Whether the process was started to ignore a signal, as `nohup` does.
fn is_ignored(signal: i32) -> bool {
    let mut action = std::mem::MaybeUninit::<libc::sigaction>::uninit();
    // SAFETY: without a new action the present one is written, in full where 0 is returned.
    unsafe {
        libc::sigaction(signal, std::ptr::null(), action.as_mut_ptr()) == 0
            && action.assume_init().sa_sigaction == libc::SIG_IGN
    }
}
