//! Zenoh, as much of it as the consumers need: for the program beside it, and by a C ABI for the one in C++
//! (../consumer-cpp) on a computer that has no zenoh-c.

use std::ffi::{c_char, c_void, CStr, CString};
use std::ptr;
use std::sync::{Arc, Mutex};

use zenoh::pubsub::Subscriber;
use zenoh::{Session, Wait};

/// With the daemon at that endpoint, and nobody else.
pub fn session(endpoint: &str) -> zenoh::Result<Session> {
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"client\"")?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    config.insert_json5("connect/endpoints", &format!("[\"{endpoint}\"]"))?;
    zenoh::open(config).wait()
}

/// Called in a thread of Zenoh's; bytes and encoding are the callee's until it returns.
pub type Take = extern "C" fn(context: *mut c_void, bytes: *const u8, size: usize, encoding: *const c_char);

pub struct Hearing {
    told: Arc<Mutex<Option<Told>>>, // None once nobody is to be told
    _subscriber: Subscriber<()>,    // before the session
    _session: Session,
}

struct Told {
    take: Take,
    context: *mut c_void,
}
unsafe impl Send for Told {} // who hears agrees to be called in Zenoh's threads

/// A subscription, or null, with the reason on standard error.
///
/// # Safety
/// Both texts end with a zero byte; `context` stays valid until `tilth_hear_no_more`.
#[no_mangle]
pub unsafe extern "C" fn tilth_hear(
    endpoint: *const c_char,
    key: *const c_char,
    take: Take,
    context: *mut c_void,
) -> *mut Hearing {
    let (endpoint, key) = (CStr::from_ptr(endpoint), CStr::from_ptr(key));
    match hear(&endpoint.to_string_lossy(), &key.to_string_lossy(), Told { take, context }) {
        Ok(hearing) => Box::into_raw(Box::new(hearing)),
        Err(error) => {
            eprintln!("{error}");
            ptr::null_mut()
        }
    }
}

/// Ends it; nothing is called afterwards.
///
/// # Safety
/// `hearing` is of `tilth_hear` and is not used again.
#[no_mangle]
pub unsafe extern "C" fn tilth_hear_no_more(hearing: *mut Hearing) {
    if !hearing.is_null() {
        let hearing = Box::from_raw(hearing);
        *hearing.told.lock().expect("no holder panics") = None; // waits for a call that is under way
    }
}

fn hear(endpoint: &str, key: &str, told: Told) -> zenoh::Result<Hearing> {
    let session = session(endpoint)?;
    let told = Arc::new(Mutex::new(Some(told)));
    let shared = told.clone();
    let subscriber = session
        .declare_subscriber(key.to_string())
        .callback(move |sample| {
            let bytes = sample.payload().to_bytes();
            let encoding = CString::new(sample.encoding().to_string()).unwrap_or_default();
            if let Some(told) = &*shared.lock().expect("no holder panics") {
                (told.take)(told.context, bytes.as_ptr(), bytes.len(), encoding.as_ptr());
            }
        })
        .wait()?;
    Ok(Hearing { told, _subscriber: subscriber, _session: session })
}
