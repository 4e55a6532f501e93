//! Reads every message of an MCAP file with the mcap crate's message loop, and prints how many
//! there are, how many bytes they hold, and how many seconds that took.

use std::{env, error::Error, fs::File, time::Instant};

fn main() -> Result<(), Box<dyn Error>> {
    let path = env::args().nth(1).ok_or("usage: rust-reader FILE")?;
    let file = unsafe { memmap2::Mmap::map(&File::open(path)?)? };
    let began = Instant::now();
    let (mut messages, mut bytes) = (0u64, 0u64);
    for message in mcap::MessageStream::new(&file)? {
        bytes += message?.data.len() as u64;
        messages += 1;
    }
    println!("{messages} {bytes} {}", began.elapsed().as_secs_f64());
    Ok(())
}
