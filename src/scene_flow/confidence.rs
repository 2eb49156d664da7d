//! Confidence of each surface element of the frames from which a view is blended. It is the fraction of the other
//! frames' scene flow maps that agree with the element.

use super::agreements::{Agreements, agreements};
use super::map::{FlowMap, MappedFrame};
use rayon::prelude::*;
use std::sync::LazyLock;

/// Weight of a scene flow map in the count of compared maps if the surface element is occluded in this map. All other
/// compared maps have the weight 1.
const HIDDEN: f32 = 0.3;
/// Number that is added to the count of confirming scene flow maps in the numerator of a confidence, so that a
/// surface element without comparable maps has a confidence too.
const PRIOR_CONFIRMED: f32 = 0.1;
/// Number that is added to the count of compared scene flow maps in the denominator of a confidence. With
/// [`PRIOR_CONFIRMED`] in the numerator, a surface element without comparable maps has the confidence 0.2.
const PRIOR_ALL: f32 = 0.5;

/// Maximum number of maps with which a map is compared for its confidences.
const MAX_COUNTED: usize = (1 << COUNT_BITS) - 1;
/// Number of bits that hold the number of maps that agree in one way.
const COUNT_BITS: usize = 5;
/// Number of combinations of three such numbers: of confirming, contradicting and hiding maps.
const COMBINATIONS: usize = 1 << (3 * COUNT_BITS);

/// For each byte of [`Agreements`], its four pixels' numbers of confirming, contradicting and hiding maps: 16 bits a
/// pixel.
static COUNTS: LazyLock<[u64; 256]> = LazyLock::new(|| {
    std::array::from_fn(|byte| {
        let count = |pixel: usize| match byte >> (2 * pixel) & 3 {
            0 => 0, // outside
            code => 1 << (16 * pixel + COUNT_BITS * (code - 1)),
        };
        (0..4).map(count).sum()
    })
});

/// Confidence by the numbers of confirming, contradicting and hiding maps.
static CONFIDENCES: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let confidence = |combination: usize| {
        let [confirmed, contradicted, hidden] =
            [0, 1, 2].map(|k| (combination >> (COUNT_BITS * k) & MAX_COUNTED) as f32);
        let all = PRIOR_ALL + confirmed + contradicted + HIDDEN * hidden;
        (255.0 * (PRIOR_CONFIRMED + confirmed) / all).round().clamp(1.0, 255.0) as u8
    };
    (0..COMBINATIONS).map(confidence).collect()
});

/// Returns the confidence of each pixel of each scene flow map, in the order of `mapped` and row by row, from 1 to 255.
/// The confidence increases with the fraction of the comparable maps that confirm the pixel's surface element.
///
/// A map is comparable if its frame is near in time and the element projects into its image. `mapped` should contain
/// only the frames around the view's instant. Then frames before the instant are compared with frames after it, which
/// confirms the motion between them. With this restriction, the PSNR of views is 1 dB higher than with confidences from
/// all frames that are near in time.
pub fn confidences(mapped: &[MappedFrame]) -> Vec<Vec<u8>> {
    let of = |(k, of): (usize, &MappedFrame)| {
        let others = mapped.iter().enumerate().filter(|(other, _)| *other != k);
        let agreements: Vec<Agreements> = others.filter_map(|(_, by)| agreements(of, by)).collect();
        confidence([of.map.width, of.map.height], &agreements.iter().collect::<Vec<_>>())
    };
    mapped.par_iter().enumerate().map(of).collect()
}

/// Returns the confidences of the pixels of a map that isn't compared with others.
pub fn uncompared(map: &FlowMap) -> Vec<u8> {
    vec![confidence([1, 1], &[])[0]; map.width * map.height]
}

/// Returns the confidence of each pixel of a scene flow map of this width and height, from 1 to 255. `agreements` are those of
/// the comparable maps, each as [`agreements`] returns them. At most 31 of them count.
pub fn confidence([width, height]: [usize; 2], agreements: &[&Agreements]) -> Vec<u8> {
    let agreements = &agreements[..agreements.len().min(MAX_COUNTED)];
    let (counts, confidences): (&[u64; 256], &[u8]) = (&COUNTS, &CONFIDENCES);
    let row_bytes = Agreements::row_bytes(width);
    let mut all = Vec::with_capacity(width * height);
    let mut row = vec![[0; 4]; row_bytes];
    for y in 0..height {
        for (x, four) in row.iter_mut().enumerate() {
            let byte = y * row_bytes + x;
            let sum: u64 = agreements.iter().map(|a| counts[usize::from(a.0[byte])]).sum();
            *four = [0, 1, 2, 3]
                .map(|pixel: usize| confidences[(sum >> (16 * pixel)) as usize % COMBINATIONS]);
        }
        all.extend_from_slice(&row.as_flattened()[..width]);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn confidence_is_the_fraction_that_confirms() {
        // Codes of `Agreements`.
        let [outside, confirmed, contradicted, hidden] = [0, 1, 2, 3];
        let all = |codes: &[u8]| {
            let each: Vec<Agreements> = codes.iter().map(|code| Agreements(vec![*code])).collect();
            confidence([1, 1], &each.iter().collect::<Vec<_>>())[0]
        };
        assert_eq!(all(&[]), 51); // 0.1 / 0.5
        assert_eq!(all(&[outside, outside]), 51);
        assert_eq!(all(&[confirmed, confirmed, confirmed]), 226); // 3.1 / 3.5
        assert_eq!(all(&[confirmed, hidden]), 156); // 1.1 / 1.8
        assert_eq!(all(&[contradicted, contradicted]), 10); // 0.1 / 2.5
    }
}
