# One macro a kind of target. Sources are relative to the calling folder; everything includes from the roots libs/,
# services/, engines/ and the generated schemas ("bus/publisher.h", "trainer/trainer.h", "wire/engine_generated.h").
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/bin")

# Headers of libraries that most sources include, parsed once a build instead of once a source, which is up to half of the
# time that a source takes. None of them is our own: an edit does not compile everything. Presets other than release and
# programs do without, and notice a source that does not include what it uses.
option(SPLATBUS_PRECOMPILED_HEADERS "Precompile the headers that most sources include" OFF)

find_program(SPLATBUS_CCACHE ccache)
if(SPLATBUS_CCACHE)
  set(CMAKE_C_COMPILER_LAUNCHER "${SPLATBUS_CCACHE}")
  set(CMAKE_CXX_COMPILER_LAUNCHER "${SPLATBUS_CCACHE}")
  set(CMAKE_CUDA_COMPILER_LAUNCHER "${SPLATBUS_CCACHE}")
  if(SPLATBUS_PRECOMPILED_HEADERS)
    # What ccache asks for where headers are precompiled (its manual, PRECOMPILED HEADERS).
    set(CMAKE_CXX_COMPILER_LAUNCHER "${CMAKE_COMMAND}" -E env CCACHE_SLOPPINESS=pch_defines,time_macros "${SPLATBUS_CCACHE}")
    add_compile_options($<$<COMPILE_LANG_AND_ID:CXX,GNU>:-fpch-preprocess>)
  endif()
endif()
find_program(SPLATBUS_MOLD mold)
if(SPLATBUS_MOLD)
  add_link_options(-fuse-ld=mold)
endif()
if(SPLATBUS_SANITIZE)
  add_compile_options(-fsanitize=${SPLATBUS_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=undefined)
  add_link_options(-fsanitize=${SPLATBUS_SANITIZE})
endif()
# A test's own expressions are not what is under test, and instrumenting them costs half of its compilation.
set(SPLATBUS_TEST_OPTIONS)
if(SPLATBUS_SANITIZE MATCHES undefined)
  set(SPLATBUS_TEST_OPTIONS -fno-sanitize=undefined)
elseif(CMAKE_BUILD_TYPE STREQUAL Release)
  # Nor is their speed, and optimizing them costs a third of their compilation.
  set(SPLATBUS_TEST_OPTIONS "$<$<COMPILE_LANGUAGE:CXX>:-O1>")
endif()
# Instrumented they take several times as long.
set(SPLATBUS_TEST_TIMEOUT_S 300)
if(SPLATBUS_SANITIZE)
  set(SPLATBUS_TEST_TIMEOUT_S 900)
endif()
# What CTest tells the sanitizers of a test and of the programs that it starts.
set(SPLATBUS_TEST_ENVIRONMENT)
if(SPLATBUS_SANITIZE MATCHES thread)
  list(APPEND SPLATBUS_TEST_ENVIRONMENT
       "TSAN_OPTIONS=suppressions=${CMAKE_SOURCE_DIR}/cmake/tsan.supp:second_deadlock_stack=1")
elseif(SPLATBUS_SANITIZE)
  list(APPEND SPLATBUS_TEST_ENVIRONMENT "ASAN_OPTIONS=detect_stack_use_after_return=1:strict_string_checks=1:quarantine_size_mb=16"
       "UBSAN_OPTIONS=print_stacktrace=1")
endif()

# splatbus_precompiled_headers(TARGET): one set for products and one, with GoogleTest, for tests. Compiled headers are of
# use only to code that is position-independent in the same way, so programs are compiled as libraries are.
function(splatbus_precompiled_headers target)
  # LibTorch has its users define a macro of libstdc++'s.
  if(target MATCHES "torch|raster_oracle")
    return()
  endif()
  get_target_property(type ${target} TYPE)
  if(target MATCHES "^test_")
    set(kind test)
  else()
    set(kind product)
  endif()
  if(type STREQUAL EXECUTABLE)
    set_target_properties(${target} PROPERTIES POSITION_INDEPENDENT_CODE OFF)
    target_compile_options(${target} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:-fPIC>)
  endif()
  set(headers splatbus_${kind}_headers)
  if(NOT TARGET ${headers})
    file(GENERATE OUTPUT "${CMAKE_BINARY_DIR}/${headers}.cpp" CONTENT "")
    add_library(${headers} OBJECT "${CMAKE_BINARY_DIR}/${headers}.cpp")
    # What changes a predefined macro has to be as it is where the headers are used.
    target_compile_options(${headers} PRIVATE -Wpedantic)
    target_link_libraries(${headers} PRIVATE cppzmq glm::glm fmt::fmt)
    if(SPLATBUS_FMT_HAS_ITS_FORMATTER)
      target_include_directories(${headers} SYSTEM BEFORE PRIVATE "${CMAKE_SOURCE_DIR}/cmake/fmt_once")
    endif()
    target_precompile_headers(
      ${headers}
      PRIVATE
        <algorithm> <array> <atomic> <chrono> <condition_variable> <cstdint> <deque> <filesystem> <fstream> <functional> <map>
        <memory> <mutex> <optional> <ranges> <set> <span> <sstream> <stdexcept> <string> <string_view> <thread>
        <unordered_map> <variant> <vector> <flatbuffers/flatbuffers.h> <fmt/format.h> <glm/glm.hpp>
        <glm/gtc/quaternion.hpp> <zmq.hpp>)
    if(kind STREQUAL test)
      target_link_libraries(${headers} PRIVATE GTest::gmock)
      target_precompile_headers(${headers} PRIVATE <gmock/gmock.h> <gtest/gtest.h>)
    endif()
  endif()
  target_precompile_headers(${target} REUSE_FROM ${headers})
  target_compile_definitions(${target} PRIVATE $<TARGET_PROPERTY:fmt::fmt,INTERFACE_COMPILE_DEFINITIONS>)
endfunction()

function(splatbus_common_options target)
  # Fields that designated initializers leave out are value-initialised, on purpose.
  target_compile_options(${target} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:-Wall -Wextra -Wpedantic -Wshadow
                                            -Wno-missing-field-initializers>)
  if(CMAKE_UNITY_BUILD)
    # For GCC a source that another includes is a header, which should keep nothing to itself.
    target_compile_options(${target} PRIVATE $<$<COMPILE_LANG_AND_ID:CXX,GNU>:-Wno-subobject-linkage>)
  endif()
  if(SPLATBUS_WARNINGS_AS_ERRORS)
    target_compile_options(
      ${target} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:-Werror>
                        $<$<COMPILE_LANGUAGE:CUDA>:-Werror=all-warnings -Xcompiler=-Werror>)
  endif()
  if(SPLATBUS_FMT_HAS_ITS_FORMATTER)
    target_include_directories(${target} SYSTEM BEFORE PRIVATE "${CMAKE_SOURCE_DIR}/cmake/fmt_once")
  endif()
  target_include_directories(${target} PUBLIC "${CMAKE_SOURCE_DIR}/libs" PRIVATE "${CMAKE_SOURCE_DIR}/services"
                                              "${CMAKE_SOURCE_DIR}/engines")
  if(SPLATBUS_PRECOMPILED_HEADERS)
    splatbus_precompiled_headers(${target})
  endif()
endfunction()

# Where sources are joined, so many of a library are: what they include is then read once, and what they instantiate
# compiled once. Tests are joined as CMAKE_UNITY_BUILD_BATCH_SIZE says: theirs take much more memory.
set(SPLATBUS_UNITY_BATCH_OF_A_LIBRARY "" CACHE STRING "Sources of a library in a unit; empty: as of everything")

# splatbus_alone(SOURCE...): kernels among these are compiled one by one, by versions of CMake too that would join them: their
# names are their own, and what nvcc compiles takes long, and is worth all cores.
function(splatbus_alone)
  set(kernels ${ARGN})
  list(FILTER kernels INCLUDE REGEX "\\.cu$")
  set_source_files_properties(${kernels} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
endfunction()

# splatbus_library(NAME SOURCES a.cpp ... DEPENDS target ... [PRIVATE_DEPENDS target ...])
function(splatbus_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;DEPENDS;PRIVATE_DEPENDS" ${ARGN})
  add_library(splatbus_${name} STATIC ${ARG_SOURCES})
  splatbus_alone(${ARG_SOURCES})
  splatbus_common_options(splatbus_${name})
  if(SPLATBUS_UNITY_BATCH_OF_A_LIBRARY)
    set_target_properties(splatbus_${name} PROPERTIES UNITY_BUILD_BATCH_SIZE ${SPLATBUS_UNITY_BATCH_OF_A_LIBRARY})
  endif()
  target_link_libraries(splatbus_${name} PUBLIC ${ARG_DEPENDS} PRIVATE ${ARG_PRIVATE_DEPENDS})
endfunction()

# splatbus_compile_sooner(TARGET): for what reads command lines and files, which is not worth the seconds that the optimizer
# would spend on it.
function(splatbus_compile_sooner target)
  target_compile_options(${target} PRIVATE $<$<AND:$<COMPILE_LANGUAGE:CXX>,$<CONFIG:Release>>:-O1>)
  # On x86 GCC 13 has another default for it at -O1, and takes no header that was precompiled with the other.
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND CMAKE_CXX_COMPILER_VERSION VERSION_GREATER_EQUAL 13 AND CMAKE_SYSTEM_PROCESSOR MATCHES "x86|AMD64")
    target_compile_options(${target} PRIVATE $<$<AND:$<COMPILE_LANGUAGE:CXX>,$<CONFIG:Release>>:-munroll-only-small-loops>)
  endif()
endfunction()

# splatbus_service(NAME SOURCES a.cpp ... DEPENDS target ...): the static library splatbus_service_NAME of all sources,
# and the program splatbus-NAME of main.cpp.
function(splatbus_service name)
  cmake_parse_arguments(ARG "" "" "SOURCES;DEPENDS" ${ARGN})
  splatbus_library(service_${name} SOURCES ${ARG_SOURCES} DEPENDS ${ARG_DEPENDS})
  splatbus_program(splatbus-${name} SOURCES main.cpp DEPENDS splatbus_service_${name})
  splatbus_compile_sooner(splatbus-${name})
endfunction()

# splatbus_cuda_sources(TARGET a.cu b.cpp ...): what a library holds besides when there is CUDA; its other sources then see
# SPLATBUS_HAVE_CUDA. Kernels (.cu) include no header of the bus and no GLM.
function(splatbus_cuda_sources target)
  if(NOT SPLATBUS_WITH_CUDA)
    return()
  endif()
  target_sources(${target} PRIVATE ${ARGN})
  splatbus_alone(${ARGN})
  target_link_libraries(${target} PUBLIC splatbus_device)
  target_compile_definitions(${target} PRIVATE SPLATBUS_HAVE_CUDA)
  target_compile_options(${target}
                         PRIVATE $<$<COMPILE_LANGUAGE:CUDA>:--expt-relaxed-constexpr -Xcompiler=-Wall,-Wextra>)
endfunction()

# splatbus_single_source(TARGET a.cu ...): sources that are written once for both devices (device/parallel.h). In a build
# with CUDA nvcc compiles them for the host and the device, in one without they are C++. Neither fuses multiplications
# with additions, so that both devices round alike. Where sources are joined, these are, in one: no two of a target have a
# name of their own in common.
function(splatbus_single_source target)
  set(sources ${ARGN})
  list(LENGTH sources count)
  if(SPLATBUS_WITH_CUDA AND CMAKE_UNITY_BUILD AND count GREATER 1)
    # nvcc needs as long to read Thrust as to compile eight of them.
    list(TRANSFORM sources REPLACE "(.+)" "#include \"${CMAKE_CURRENT_SOURCE_DIR}/\\1\"" OUTPUT_VARIABLE includes)
    list(JOIN includes "\n" includes)
    set(joined "${CMAKE_CURRENT_BINARY_DIR}/${target}_joined.cu")
    file(CONFIGURE OUTPUT "${joined}" CONTENT "${includes}\n" @ONLY)
    set(sources "${joined}")
  endif()
  target_sources(${target} PRIVATE ${sources})
  target_link_libraries(${target} PUBLIC splatbus_device)
  if(SPLATBUS_WITH_CUDA)
    splatbus_alone(${sources})
    set_source_files_properties(${sources} PROPERTIES COMPILE_OPTIONS "--fmad=false;-Xcompiler=-ffp-contract=off")
    target_compile_options(${target}
                           PRIVATE $<$<COMPILE_LANGUAGE:CUDA>:--expt-relaxed-constexpr -Xcompiler=-Wall,-Wextra>)
  else()
    # Debian's headers of Thrust, which bind references to null; with CUDA they are the toolkit's own.
    set(options -x c++ -ffp-contract=off -Wno-shadow -Wno-pedantic)
    if(SPLATBUS_SANITIZE MATCHES undefined)
      list(APPEND options -fno-sanitize=null)
    endif()
    set_source_files_properties(
      ${ARGN} PROPERTIES LANGUAGE CXX COMPILE_OPTIONS "${options}"
                         COMPILE_DEFINITIONS THRUST_DEVICE_SYSTEM=THRUST_DEVICE_SYSTEM_TBB)
  endif()
endfunction()

# splatbus_program(NAME SOURCES a.cpp ... DEPENDS target ...)
function(splatbus_program name)
  cmake_parse_arguments(ARG "" "" "SOURCES;DEPENDS" ${ARGN})
  add_executable(${name} ${ARG_SOURCES})
  splatbus_common_options(${name})
  target_link_libraries(${name} PRIVATE ${ARG_DEPENDS})
endfunction()

# What reads what others send or shares memory with them: CI runs these under sanitizers, by the label untrusted.
add_custom_target(untrusted_tests)

# splatbus_test(NAME [UNTRUSTED] SOURCES a.cpp ... DEPENDS target ... [LABEL integration] [TIMEOUT s] [PROGRAMS target ...])
# PROGRAMS are built first, and found by the test in SPLATBUS_BIN_DIR.
function(splatbus_test name)
  cmake_parse_arguments(ARG "UNTRUSTED" "LABEL;TIMEOUT" "SOURCES;DEPENDS;PROGRAMS" ${ARGN})
  add_executable(test_${name} ${ARG_SOURCES})
  splatbus_common_options(test_${name})
  target_link_libraries(test_${name} PRIVATE ${ARG_DEPENDS} GTest::gmock GTest::gtest_main)
  target_compile_definitions(
    test_${name} PRIVATE SPLATBUS_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}" SPLATBUS_SOURCE_DIR="${CMAKE_SOURCE_DIR}")
  if(ARG_PROGRAMS)
    add_dependencies(test_${name} ${ARG_PROGRAMS})
  endif()
  if(ARG_UNTRUSTED)
    list(APPEND ARG_LABEL untrusted)
    add_dependencies(untrusted_tests test_${name})
  endif()
  add_test(NAME ${name} COMMAND test_${name})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT ${SPLATBUS_TEST_TIMEOUT_S})
  endif()
  set_tests_properties(${name} PROPERTIES LABELS "${ARG_LABEL}" TIMEOUT ${ARG_TIMEOUT}
                                          ENVIRONMENT "${SPLATBUS_TEST_ENVIRONMENT}")
endfunction()

# splatbus_one_at_a_time(TEST ...): tests of whole pipelines and of browsers. Two of them at once would be more than their
# bounds on progress are for; one beside a test of a single process is not, and leaves it a core while it waits. They begin
# first, so that there is something left to run beside each.
function(splatbus_one_at_a_time)
  set_tests_properties(${ARGN} PROPERTIES RESOURCE_LOCK machine COST 1000)
  if(SPLATBUS_SANITIZE)
    set_tests_properties(${ARGN} PROPERTIES RUN_SERIAL TRUE)
  endif()
endfunction()
