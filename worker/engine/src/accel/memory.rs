//! Memory for large arrays that walks touch all over.

use bytemuck::Zeroable;

/// Zeroed elements, in huge pages where the system lends them: a walk touches memory all over the structure, and
/// with small pages a good part of it would be address translation.
pub(super) fn fresh<T: Copy + Zeroable>(len: usize) -> Vec<T> {
    let mut elements = Vec::with_capacity(len);
    advise_huge_pages(&elements);
    elements.resize(len, T::zeroed());
    elements
}

#[cfg(target_os = "linux")]
fn advise_huge_pages<T>(elements: &Vec<T>) {
    const HUGE: usize = 2 << 20;
    let start = (elements.as_ptr() as usize).next_multiple_of(HUGE);
    let end = elements.as_ptr() as usize + elements.capacity() * size_of::<T>();
    if start + HUGE <= end {
        // SAFETY: the range lies inside this vector's own allocation, and the advice never changes what memory holds.
        // Where the kernel declines, small pages serve as well.
        unsafe { libc::madvise(start as *mut libc::c_void, (end - start) & !(HUGE - 1), libc::MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn advise_huge_pages<T>(_elements: &Vec<T>) {}
