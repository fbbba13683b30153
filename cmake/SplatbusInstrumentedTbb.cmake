# ThreadSanitizer learns from the scheduler's own atomics that a task runs after the one that spawned it, and before the
# one that waits for it. Debian's libtbb is not instrumented: with it every parallel loop is reported. So the same
# release is built here, from Debian's source package.
set(SPLATBUS_TBB_SOURCE "${CMAKE_SOURCE_DIR}/build/onetbb" CACHE PATH "Sources of oneTBB, as in Debian's package onetbb")
if(NOT EXISTS "${SPLATBUS_TBB_SOURCE}/CMakeLists.txt")
  message(FATAL_ERROR "No sources of oneTBB in ${SPLATBUS_TBB_SOURCE}: `./splatbus build --preset tsan` fetches them")
endif()
set(TBB_TEST OFF CACHE BOOL "")
set(TBB_STRICT OFF CACHE BOOL "")
set(TBB_ENABLE_IPO OFF CACHE BOOL "")
set(TBBMALLOC_BUILD OFF CACHE BOOL "")
add_subdirectory("${SPLATBUS_TBB_SOURCE}" "${CMAKE_BINARY_DIR}/onetbb" EXCLUDE_FROM_ALL)
# It has fences, which GCC's ThreadSanitizer does not model. They order who sleeps and who is woken, and nothing that
# tasks hand to each other.
target_compile_options(tbb PRIVATE -Wno-tsan)
