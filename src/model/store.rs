//! Many numbers, owned or mapped from a file.

use std::fs::File;
use std::io::Read;
use std::ops::{Deref, Range};
use std::path::Path;
use std::sync::Arc;

use memmap2::Mmap;

const MAGIC: &[u8; 8] = b"tissueP1";
/// Magic, key, count, check: 8 bytes each; then the numbers.
const HEADER: usize = 64;

/// Why a file is not read. The text after the file's name.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("cannot be read: {0}")]
    Read(#[from] std::io::Error),
    #[error("is damaged or of another version; build the FMU again")]
    Damaged,
}

/// A slice of f64 that is cheap to divide and to share.
#[derive(Clone, Debug)]
pub struct Numbers {
    source: Source,
    range: Range<usize>,
}

#[derive(Clone, Debug)]
enum Source {
    Own(Arc<Vec<f64>>),
    Mapped(Arc<Mmap>),
}

impl Default for Numbers {
    fn default() -> Numbers {
        Vec::new().into()
    }
}

impl From<Vec<f64>> for Numbers {
    fn from(numbers: Vec<f64>) -> Numbers {
        Numbers {
            range: 0..numbers.len(),
            source: Source::Own(Arc::new(numbers)),
        }
    }
}

impl Deref for Numbers {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        let all: &[f64] = match &self.source {
            Source::Own(numbers) => numbers,
            // SAFETY: a mapping starts on a page; HEADER is a multiple of 8 and open() has checked the
            // length; any bits are a number.
            Source::Mapped(map) => unsafe {
                let bytes = &map[HEADER..];
                std::slice::from_raw_parts(bytes.as_ptr().cast(), bytes.len() / 8)
            },
        };
        &all[self.range.clone()]
    }
}

impl Numbers {
    /// Consecutive pieces of these lengths, if they add up.
    pub fn split(&self, lengths: &[usize]) -> Option<Vec<Numbers>> {
        let mut at = self.range.start;
        let pieces = lengths.iter().map(|length| {
            at += length;
            Numbers {
                source: self.source.clone(),
                range: at - length..at,
            }
        });
        let pieces: Vec<Numbers> = pieces.collect();
        (at == self.range.end).then_some(pieces)
    }
}

/// A file of numbers that belong to `key`. Little-endian.
pub fn bytes(key: u64, numbers: &[f64]) -> Vec<u8> {
    let mut header = [0u8; HEADER];
    header[..8].copy_from_slice(MAGIC);
    header[8..16].copy_from_slice(&key.to_le_bytes());
    header[16..24].copy_from_slice(&(numbers.len() as u64).to_le_bytes());
    header[24..32].copy_from_slice(&check(numbers).to_le_bytes());
    let mut bytes = Vec::with_capacity(HEADER + 8 * numbers.len());
    bytes.extend_from_slice(&header);
    numbers
        .iter()
        .for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    bytes
}

/// Opens a file of [`bytes()`]; none if it belongs to another key. Mapped on little-endian machines.
pub fn open(path: &Path, key: u64) -> Result<Option<Numbers>, StoreError> {
    let mut file = File::open(path)?;
    let mut header = [0u8; HEADER];
    file.read_exact(&mut header)
        .map_err(|_| StoreError::Damaged)?;
    let word = |at: usize| {
        let mut bytes = [0u8; 8];
        bytes.copy_from_slice(&header[at..at + 8]);
        u64::from_le_bytes(bytes)
    };
    let length = file.metadata()?.len();
    let count = word(16);
    if &header[..8] != MAGIC
        || count
            .checked_mul(8)
            .and_then(|n| n.checked_add(HEADER as u64))
            != Some(length)
    {
        return Err(StoreError::Damaged);
    }
    if word(8) != key {
        return Ok(None);
    }
    let source = if cfg!(target_endian = "little") {
        // SAFETY: the FMU's own resource; whoever changes it under a running FMU breaks that FMU.
        Source::Mapped(Arc::new(unsafe { Mmap::map(&file)? }))
    } else {
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)?;
        let (words, _) = bytes.as_chunks::<8>();
        Source::Own(Arc::new(
            words.iter().map(|w| f64::from_le_bytes(*w)).collect(),
        ))
    };
    let numbers = Numbers {
        source,
        range: 0..count as usize,
    };
    if check(&numbers) != word(24) {
        return Err(StoreError::Damaged);
    }
    Ok(Some(numbers))
}

/// Four interleaved multiplicative hashes: as fast as memory.
fn check(numbers: &[f64]) -> u64 {
    let mut lanes = [0x9e37_79b9_7f4a_7c15u64, 2, 3, 4];
    let step = |lane: u64, x: &f64| {
        (lane ^ x.to_bits())
            .wrapping_mul(0x2127_599b_f432_5c37)
            .rotate_left(29)
    };
    let (blocks, rest) = numbers.as_chunks::<4>();
    for block in blocks {
        for (lane, x) in lanes.iter_mut().zip(block) {
            *lane = step(*lane, x);
        }
    }
    for x in rest {
        lanes[0] = step(lanes[0], x);
    }
    let fold = |sum: u64, lane: u64| {
        (sum ^ lane)
            .wrapping_mul(0x2127_599b_f432_5c37)
            .rotate_left(31)
    };
    lanes.into_iter().fold(numbers.len() as u64, fold)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_gives_back_its_numbers_and_tells_damage() {
        let folder = std::env::temp_dir().join(format!("tissue-store-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("numbers.bin");
        let numbers: Vec<f64> = (0..1003).map(|k| f64::from(k).sqrt()).collect();
        let bytes = bytes(7, &numbers);
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(&*open(&path, 7).unwrap().unwrap(), numbers.as_slice());
        assert!(open(&path, 8).unwrap().is_none());
        for at in [0, 17, 30, HEADER + 5, bytes.len() - 1] {
            let mut bad = bytes.clone();
            bad[at] ^= 1;
            std::fs::write(&path, &bad).unwrap();
            assert!(open(&path, 7).is_err(), "byte {at}");
        }
        std::fs::write(&path, &bytes[..bytes.len() - 8]).unwrap();
        assert!(open(&path, 7).is_err());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn pieces_must_add_up() {
        let numbers: Numbers = vec![1.0, 2.0, 3.0].into();
        let pieces = numbers.split(&[1, 0, 2]).unwrap();
        assert_eq!(
            (&*pieces[0], &*pieces[1], &*pieces[2]),
            (&[1.0][..], &[][..], &[2.0, 3.0][..])
        );
        assert!(numbers.split(&[1, 1]).is_none());
    }
}
