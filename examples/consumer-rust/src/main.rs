//! Hears the recommended estimate of a Tilth daemon and says, once a second, what a controller may use.
//!
//!     cargo run --release -- tcp/127.0.0.1:7447 tilth/jd7930-parker500 [LINES]
//!
//! The messages are those of schemas/proto/tilth.proto, written down as far as they are needed here: a field
//! that is not named is passed over, as one that a later version adds. What is `optional` there is `optional`
//! and an `Option` here: without that word, prost reads 0.0 where a number is absent.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use prost::Message;
use zenoh::Wait;

const SILENCE: Duration = Duration::from_secs(3); // choose what your loop can bear
const DATA_S: f64 = 300.0; // at 2 m/s, 600 m of field
const ESTIMATED: i32 = 1;
const NAMES: [&str; 6] = ["C_af", "C_ar", "C_ai", "sigma_f", "sigma_r", "sigma_i"];

#[derive(Clone, PartialEq, Message)]
struct Parameter {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(double, optional, tag = "2")]
    value: Option<f64>,
    #[prost(double, optional, tag = "3")]
    sd: Option<f64>,
    #[prost(int32, tag = "4")]
    status: i32,
    #[prost(string, tag = "5")]
    reason: String,
    #[prost(double, optional, tag = "6")]
    age_s: Option<f64>,
}

#[derive(Clone, PartialEq, Message)]
struct SoilTireEstimate {
    #[prost(fixed64, tag = "1")]
    t_ns: u64,
    #[prost(string, tag = "2")]
    method: String,
    #[prost(message, repeated, tag = "4")]
    parameters: Vec<Parameter>,
}

struct Held {
    estimate: SoilTireEstimate,
    heard: Instant, // by this computer's own clock: clocks need not agree
}

/// Why this parameter may not be used now, or its value.
fn usable(held: Option<&Held>, i: usize, now: Instant) -> Result<f64, String> {
    let held = held.ok_or("nothing has been heard yet")?;
    let age = now.duration_since(held.heard);
    if age > SILENCE {
        return Err(format!("no estimate for {:.1} s", age.as_secs_f64()));
    }
    let row = &held.estimate.parameters[i];
    if row.status != ESTIMATED {
        return Err(row.reason.clone());
    }
    match (row.value, row.sd, row.age_s) {
        (Some(_), Some(_), Some(data)) if !(data + age.as_secs_f64() <= DATA_S) => {
            Err(format!("data last informed it {data:.0} s ago"))
        }
        (Some(value), Some(sd), _) if value.is_finite() && value > 0.0 && sd.is_finite() && sd > 0.0 => Ok(value),
        _ => Err("its value is none".into()),
    }
}

fn take(sample: &zenoh::sample::Sample, last: &Mutex<Option<Held>>) -> Result<(), String> {
    if sample.encoding().to_string() != "application/protobuf;tilth.SoilTireEstimate" {
        return Err(format!("its encoding is {}", sample.encoding()));
    }
    let bytes = sample.payload().to_bytes();
    let estimate = SoilTireEstimate::decode(&*bytes).map_err(|error| error.to_string())?;
    if !estimate.parameters.iter().map(|row| row.name.as_str()).eq(NAMES) {
        return Err("not the six parameters of this version".into());
    }
    let mut held = last.lock().expect("no holder panics");
    if held.as_ref().is_some_and(|old| old.estimate.t_ns == estimate.t_ns) {
        return Err("the same estimate again".into()); // it does not grow younger
    }
    *held = Some(Held { estimate, heard: Instant::now() });
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [endpoint, base, rest @ ..] = words.as_slice() else {
        eprintln!("tilth-consumer ENDPOINT PREFIX/MACHINE [LINES]");
        std::process::exit(2);
    };
    let lines: u64 = rest.first().map_or(Ok(u64::MAX), |word| word.parse())?;
    let session = tilth_consumer::session(endpoint)?;
    let last = Arc::new(Mutex::new(None));
    let shared = last.clone();
    let _subscriber = session
        .declare_subscriber(format!("{base}/soil_tire"))
        .callback(move |sample| {
            if let Err(why) = take(&sample, &shared) {
                eprintln!("refused: {why}");
            }
        })
        .wait()?;
    for _ in 0..lines {
        std::thread::sleep(Duration::from_secs(1));
        let held = last.lock().expect("no holder panics");
        let now = Instant::now();
        let told: Vec<String> = (0..NAMES.len())
            .map(|i| match usable(held.as_ref(), i, now) {
                Ok(value) => format!("{}={value:.4}", NAMES[i]),
                Err(why) => format!("{}: {why}", NAMES[i]),
            })
            .collect();
        println!("{}", told.join("; "));
    }
    Ok(())
}
