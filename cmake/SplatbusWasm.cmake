# The viewer's half of the stream for browsers, web/wasm, by emscripten: the target splatbus_wasm, as
# SPLATBUS_WASM. Without em++ or Debian's sources, which `./splatbus build` fetches, the page is not built.
set(SPLATBUS_DRACO_SOURCE "${CMAKE_SOURCE_DIR}/build/draco" CACHE PATH "Sources of Draco, as in Debian's package draco")
set(SPLATBUS_ZSTD_SOURCE "${CMAKE_SOURCE_DIR}/build/libzstd" CACHE PATH "Sources of Zstandard, as in Debian's package libzstd")
find_program(SPLATBUS_EMXX em++)
find_file(SPLATBUS_EMSCRIPTEN_TOOLCHAIN Emscripten.cmake
          PATHS /usr/share/emscripten/cmake/Modules/Platform "$ENV{EMSDK}/upstream/emscripten/cmake/Modules/Platform")
set(SPLATBUS_WASM)
if(SPLATBUS_SANITIZE)
  # The module is the same whatever watches over the programs.
elseif(NOT SPLATBUS_EMXX OR NOT SPLATBUS_EMSCRIPTEN_TOOLCHAIN)
  message(STATUS "No em++ here, so the page is not built")
elseif(NOT EXISTS "${SPLATBUS_DRACO_SOURCE}/src/draco" OR NOT EXISTS "${SPLATBUS_ZSTD_SOURCE}/lib")
  message(STATUS "No sources of draco and libzstd in build/, so the page is not built; `./splatbus build` fetches them")
else()
  include(ExternalProject)
  set(SPLATBUS_WASM "${CMAKE_BINARY_DIR}/wasm/splatbus.wasm")
  ExternalProject_Add(
    splatbus_wasm
    SOURCE_DIR "${CMAKE_SOURCE_DIR}/web/wasm"
    BINARY_DIR "${CMAKE_BINARY_DIR}/wasm"
    PREFIX "${CMAKE_BINARY_DIR}/CMakeFiles/wasm"
    DEPENDS splatbus_wire_generate
    CMAKE_ARGS "-DCMAKE_TOOLCHAIN_FILE=${SPLATBUS_EMSCRIPTEN_TOOLCHAIN}" -DCMAKE_BUILD_TYPE=Release
               "-DSPLATBUS_WARNINGS_AS_ERRORS=${SPLATBUS_WARNINGS_AS_ERRORS}"
               "-DSPLATBUS_WIRE_INCLUDE=${CMAKE_BINARY_DIR}/schemas/include"
               "-DSPLATBUS_DRACO_SOURCE=${SPLATBUS_DRACO_SOURCE}" "-DSPLATBUS_ZSTD_SOURCE=${SPLATBUS_ZSTD_SOURCE}"
    BUILD_ALWAYS ON
    BUILD_BYPRODUCTS "${SPLATBUS_WASM}"
    INSTALL_COMMAND ""
    USES_TERMINAL_BUILD ON)
endif()
