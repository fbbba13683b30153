# ThreadSanitizer learns from the scheduler's own atomics that a task runs after the one that spawned it, and before the
# one that waits for it. Debian's libtbb is not instrumented: with it every parallel loop is reported. So the same
# release is built here, from Debian's source archive.
include(FetchContent)
set(TBB_TEST OFF CACHE BOOL "")
set(TBB_STRICT OFF CACHE BOOL "")
set(TBB_ENABLE_IPO OFF CACHE BOOL "")
set(TBBMALLOC_BUILD OFF CACHE BOOL "")
FetchContent_Declare(
  onetbb
  URL http://deb.debian.org/debian/pool/main/o/onetbb/onetbb_2021.8.0.orig.tar.xz
  URL_HASH SHA256=7e9111b8bb59c8800bf6d0b06afe7b0891937443d2dae1ee1101c8e2ede6a7ef
  DOWNLOAD_EXTRACT_TIMESTAMP OFF)
FetchContent_MakeAvailable(onetbb)
# It has fences, which GCC's ThreadSanitizer does not model. They order who sleeps and who is woken, and nothing that
# tasks hand to each other.
target_compile_options(tbb PRIVATE -Wno-tsan)
