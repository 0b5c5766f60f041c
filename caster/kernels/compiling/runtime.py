"""Functions of Numba's runtime that compiled kernels call, in LLVM's language, so that they run without Numba.

Arrays that are handed to a kernel own no memory as far as it knows (their record is null); what it allocates itself it
frees before it returns, so that a record is all of its memory.
"""

# A record as Numba's code reads it: count of references, two fields for others, address of the data, size of the data.
RECORD = 64  # bytes, of which it reads 40

ALLOCATE = f"""
define ptr @NRT_MemInfo_alloc_aligned(i64 %size, i32 %alignment) {{
  %step = zext i32 %alignment to i64
  %room = add i64 %size, {RECORD}
  %whole = add i64 %room, %step
  %record = call ptr @malloc(i64 %whole)
  %none = icmp eq ptr %record, null
  br i1 %none, label %done, label %fill
fill:
  %first = ptrtoint ptr %record to i64
  %behind = add i64 %first, {RECORD}
  %less = sub i64 %step, 1
  %beyond = add i64 %behind, %less
  %down = sub i64 0, %step
  %data = and i64 %beyond, %down
  store i64 1, ptr %record
  %record.1 = getelementptr i64, ptr %record, i64 1
  store i64 0, ptr %record.1
  %record.2 = getelementptr i64, ptr %record, i64 2
  store i64 0, ptr %record.2
  %record.3 = getelementptr i64, ptr %record, i64 3
  store i64 %data, ptr %record.3
  %record.4 = getelementptr i64, ptr %record, i64 4
  store i64 %size, ptr %record.4
  br label %done
done:
  ret ptr %record
}}
declare ptr @malloc(i64)
"""

FREE = """
define void @NRT_MemInfo_call_dtor(ptr %record) {
  call void @free(ptr %record)
  ret void
}
declare void @free(ptr)
"""

TIMES_POWER = """
define double @numba_ldexp(double %x, i32 %exponent) {
  %y = call double @ldexp(double %x, i32 %exponent)
  ret double %y
}
declare double @ldexp(double, i32)
"""

# What is not finite has the exponent 0 for Numba, and any in C.
EXPONENT = """
define double @numba_frexp(double %x, ptr %exponent) {
  %y = call double @frexp(double %x, ptr %exponent)
  %off = fsub double %x, %x
  %finite = fcmp oeq double %off, 0.0
  br i1 %finite, label %done, label %special
special:
  store i32 0, ptr %exponent
  br label %done
done:
  ret double %y
}
declare double @frexp(double, ptr)
"""

RUNTIME = {
    "NRT_MemInfo_alloc_aligned": ALLOCATE,
    "NRT_MemInfo_call_dtor": FREE,
    "numba_ldexp": TIMES_POWER,
    "numba_frexp": EXPONENT,
}

MATHEMATICS = (
    "acos asin atan atan2 ceil cos exp fabs floor fma fmod frexp hypot ldexp log pow rint round sin sqrt tan"
)
FROM_C = {*MATHEMATICS.split(" "), "trunc", "malloc", "free", "memcpy", "memmove", "memset"}
"""What object code may ask of the C library; anything else would be Numba's own."""
