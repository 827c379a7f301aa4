//! The few vector operations that the kernels are written in, for AVX2 and for any machine.
//!
//! Both kinds do the same IEEE arithmetic, without fused multiply-add, in the same order: so the kernels find the same
//! hits, bit for bit, on every CPU. (The watertight edge functions could not be fused anyway: a fused product is not
//! antisymmetric.)

use crate::accel::wide::Node;

/// A vector of `N` floats. Comparisons give a bit for each lane.
///
/// `min` and `max` are x86's: where an operand is NaN, or both are zero, the second is the result.
pub(crate) trait Lanes<const N: usize>: Copy {
    fn splat(value: f32) -> Self;
    fn load(values: &[f32; N]) -> Self;
    fn store(self) -> [f32; N];
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    fn sqrt(self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    fn less(self, other: Self) -> u32;
    fn less_or_equal(self, other: Self) -> u32;
}

/// An instruction set: its vectors, and the one step that is not arithmetic.
pub(crate) trait Isa: Copy {
    type F4: Lanes<4>;
    type F8: Lanes<8>;

    /// Writes the children whose box is met (`near <= far`) and their entry distances to the front of `children` and
    /// `distances`, the farthest in the node's order of this octant first. Gives their number; what stands behind is
    /// arbitrary.
    ///
    /// # Safety
    /// Both pointers must be good to write eight numbers through.
    unsafe fn push_children(
        node: &Node,
        octant_shift: u32,
        near: Self::F8,
        far: Self::F8,
        children: *mut u32,
        distances: *mut f32,
    ) -> usize;
}

/// Writes an `impl Lanes` from one expression for each operation.
macro_rules! implement_lanes {
    (
        [$($generics:tt)*] $type:ty, [f32; $n:tt];
        splat |$value:ident| $splat:expr;
        load |$values:ident| $load:expr;
        store |$stored:ident| $store:expr;
        sqrt |$radicand:ident| $sqrt:expr;
        $(vector $vector:ident |$va:ident, $vb:ident| $vector_body:expr;)*
        $(mask $mask:ident |$ma:ident, $mb:ident| $mask_body:expr;)*
    ) => {
        impl<$($generics)*> Lanes<$n> for $type {
            #[inline(always)]
            fn splat($value: f32) -> Self {
                $splat
            }
            #[inline(always)]
            fn load($values: &[f32; $n]) -> Self {
                $load
            }
            #[inline(always)]
            fn store(self) -> [f32; $n] {
                let $stored = self;
                $store
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                let $radicand = self;
                $sqrt
            }
            $(
                #[inline(always)]
                fn $vector(self, other: Self) -> Self {
                    let ($va, $vb) = (self, other);
                    $vector_body
                }
            )*
            $(
                #[inline(always)]
                fn $mask(self, other: Self) -> u32 {
                    let ($ma, $mb) = (self, other);
                    $mask_body
                }
            )*
        }
    };
}

/// Plain Rust.
#[derive(Clone, Copy)]
pub(crate) struct Portable;

#[derive(Clone, Copy)]
pub(crate) struct Plain<const N: usize>([f32; N]);

impl<const N: usize> Plain<N> {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|lane| f(self.0[lane], other.0[lane])))
    }

    #[inline(always)]
    fn compare(self, other: Self, f: impl Fn(f32, f32) -> bool) -> u32 {
        (0..N).fold(0, |mask, lane| mask | u32::from(f(self.0[lane], other.0[lane])) << lane)
    }
}

implement_lanes! {
    [const N: usize] Plain<N>, [f32; N];
    splat |value| Self([value; N]);
    load |values| Self(*values);
    store |a| a.0;
    sqrt |a| Self(a.0.map(f32::sqrt));
    vector add |a, b| a.zip(b, |a, b| a + b);
    vector sub |a, b| a.zip(b, |a, b| a - b);
    vector mul |a, b| a.zip(b, |a, b| a * b);
    vector div |a, b| a.zip(b, |a, b| a / b);
    vector min |a, b| a.zip(b, |a, b| if a < b { a } else { b });
    vector max |a, b| a.zip(b, |a, b| if a > b { a } else { b });
    mask less |a, b| a.compare(b, |a, b| a < b);
    mask less_or_equal |a, b| a.compare(b, |a, b| a <= b);
}

impl Isa for Portable {
    type F4 = Plain<4>;
    type F8 = Plain<8>;

    #[inline(always)]
    unsafe fn push_children(
        node: &Node,
        octant_shift: u32,
        near: Self::F8,
        far: Self::F8,
        children: *mut u32,
        distances: *mut f32,
    ) -> usize {
        let mut count = 0;
        for entry in node.order {
            let slot = (entry >> octant_shift & 7) as usize;
            if near.0[slot] <= far.0[slot] {
                // SAFETY: at most eight are written, as the caller allows.
                unsafe {
                    children.add(count).write(node.children[slot]);
                    distances.add(count).write(near.0[slot]);
                }
                count += 1;
            }
        }
        count
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::Avx2;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::{Isa, Lanes};
    use crate::accel::wide::{Node, WIDTH};

    /// Intel and AMD since about 2013. Values of these types exist only inside functions compiled for AVX2, which the
    /// entry points in [`crate::trace::kernel`] call after they have asked the CPU: that is what makes the intrinsics
    /// below sound.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx2;

    #[derive(Clone, Copy)]
    pub(crate) struct F4(__m128);
    #[derive(Clone, Copy)]
    pub(crate) struct F8(__m256);

    /// Lane numbers of the set bits of each mask, lowest first.
    static SET_LANES: [[u8; WIDTH]; 256] = {
        let mut table = [[0; WIDTH]; 256];
        let mut mask = 0;
        while mask < 256 {
            let (mut lane, mut count) = (0, 0);
            while lane < WIDTH {
                if mask >> lane & 1 == 1 {
                    table[mask][count] = lane as u8;
                    count += 1;
                }
                lane += 1;
            }
            mask += 1;
        }
        table
    };

    /// Vectors of one width, by the names of their intrinsics.
    macro_rules! vectors {
        ($type:ident, $n:tt, $set1:ident, $load:ident, $store:ident, $add:ident, $sub:ident, $mul:ident, $div:ident,
         $sqrt:ident, $min:ident, $max:ident, $cmp:ident, $movemask:ident) => {
            // SAFETY (all of them): AVX2 is there, see `Avx2`; arrays of the vector's size are read and written
            // unaligned.
            #[allow(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
            const _: () = {
                implement_lanes! {
                    [] $type, [f32; $n];
                    splat |value| Self(unsafe { $set1(value) });
                    load |values| Self(unsafe { $load(values.as_ptr()) });
                    store |a| {
                        let mut values = [0.0; $n];
                        unsafe { $store(values.as_mut_ptr(), a.0) };
                        values
                    };
                    sqrt |a| Self(unsafe { $sqrt(a.0) });
                    vector add |a, b| Self(unsafe { $add(a.0, b.0) });
                    vector sub |a, b| Self(unsafe { $sub(a.0, b.0) });
                    vector mul |a, b| Self(unsafe { $mul(a.0, b.0) });
                    vector div |a, b| Self(unsafe { $div(a.0, b.0) });
                    vector min |a, b| Self(unsafe { $min(a.0, b.0) });
                    vector max |a, b| Self(unsafe { $max(a.0, b.0) });
                    mask less |a, b| unsafe { $movemask($cmp::<_CMP_LT_OQ>(a.0, b.0)) as u32 };
                    mask less_or_equal |a, b| unsafe { $movemask($cmp::<_CMP_LE_OQ>(a.0, b.0)) as u32 };
                }
            };
        };
    }
    vectors!(
        F4,
        4,
        _mm_set1_ps,
        _mm_loadu_ps,
        _mm_storeu_ps,
        _mm_add_ps,
        _mm_sub_ps,
        _mm_mul_ps,
        _mm_div_ps,
        _mm_sqrt_ps,
        _mm_min_ps,
        _mm_max_ps,
        _mm_cmp_ps,
        _mm_movemask_ps
    );
    vectors!(
        F8,
        8,
        _mm256_set1_ps,
        _mm256_loadu_ps,
        _mm256_storeu_ps,
        _mm256_add_ps,
        _mm256_sub_ps,
        _mm256_mul_ps,
        _mm256_div_ps,
        _mm256_sqrt_ps,
        _mm256_min_ps,
        _mm256_max_ps,
        _mm256_cmp_ps,
        _mm256_movemask_ps
    );

    impl Isa for Avx2 {
        type F4 = F4;
        type F8 = F8;

        #[inline(always)]
        unsafe fn push_children(
            node: &Node,
            octant_shift: u32,
            near: F8,
            far: F8,
            children: *mut u32,
            distances: *mut f32,
        ) -> usize {
            // SAFETY: AVX2 is there, see `Avx2`. Loads and stores are unaligned and of eight numbers, which the caller
            // allows.
            unsafe {
                let order = _mm256_loadu_si256(node.order.as_ptr().cast());
                let order = _mm256_srl_epi32(order, _mm_cvtsi32_si128(octant_shift as i32));
                let met = _mm256_cmp_ps::<_CMP_LE_OQ>(near.0, far.0);
                // The permutation looks at the low three bits of each entry only.
                let met = _mm256_movemask_ps(_mm256_permutevar8x32_ps(met, order)) as u32;
                let set = SET_LANES[met as usize & 255].as_ptr();
                let compress = _mm256_cvtepu8_epi32(_mm_loadl_epi64(set.cast()));
                let order = _mm256_permutevar8x32_epi32(order, compress);
                let from = _mm256_loadu_si256(node.children.as_ptr().cast());
                _mm256_storeu_si256(children.cast(), _mm256_permutevar8x32_epi32(from, order));
                _mm256_storeu_ps(distances, _mm256_permutevar8x32_ps(near.0, order));
                met.count_ones() as usize
            }
        }
    }
}
