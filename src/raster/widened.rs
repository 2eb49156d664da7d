//! Loops that are compiled twice: for every processor, and for AVX2.

/// Defines a function that calls another one, which must be `#[inline(always)]`: compiled for AVX2 where the
/// processor has it. The operations are the same, without fused products, and so are the results, to the bit.
macro_rules! widened {
    ($(#[$meta:meta])* $visibility:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) $(-> $result:ty)? = $any:path) => {
        $(#[$meta])*
        $visibility fn $name($($argument: $type),*) $(-> $result)? {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            fn by_avx2($($argument: $type),*) $(-> $result)? {
                $any($($argument),*)
            }
            #[cfg(target_arch = "x86_64")]
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has the feature.
                return unsafe { by_avx2($($argument),*) };
            }
            $any($($argument),*)
        }
    };
}

pub(crate) use widened;
