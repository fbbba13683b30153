# The page, web/, into share/splatbus/web beside bin/, where the gateway finds it: the target splatbus_web. It needs the
# module of SplatbusWasm, Node.js 18 or later, and npm with a registry for what the lock file names or, without npm,
# Debian's esbuild. Where one of them is missing the page is not built, and all else is.
include(SplatbusWasm)
set(SPLATBUS_WEB)
find_program(SPLATBUS_NODE NAMES node nodejs)
find_program(SPLATBUS_NPM npm)
if(NOT SPLATBUS_WASM)
  return()
elseif(NOT SPLATBUS_NODE)
  message(STATUS "No node here, so the page is not built")
  return()
endif()

set(web "${CMAKE_SOURCE_DIR}/web")
set(installed "${web}/node_modules/.package-lock.json")
if(SPLATBUS_NPM AND (NOT EXISTS "${installed}" OR "${web}/package-lock.json" IS_NEWER_THAN "${installed}"))
  message(STATUS "Installing what the page is built with, by npm ci")
  execute_process(
    COMMAND "${SPLATBUS_NPM}" ci --ignore-scripts --no-audit --no-fund --loglevel=error --fetch-retry-maxtimeout=10000
    WORKING_DIRECTORY "${web}"
    TIMEOUT 300
    RESULT_VARIABLE result
    OUTPUT_VARIABLE said
    ERROR_VARIABLE said)
  if(result EQUAL 0)
    file(TOUCH "${installed}")
  else()
    message(STATUS "npm ci failed (${result}); `cmake ${CMAKE_BINARY_DIR}` tries again. ${said}")
  endif()
endif()
execute_process(
  COMMAND "${SPLATBUS_NODE}" -e "require('esbuild').transformSync('')"
  WORKING_DIRECTORY "${web}"
  RESULT_VARIABLE result
  OUTPUT_QUIET ERROR_QUIET)
if(NOT result EQUAL 0)
  message(STATUS "No esbuild here, of npm or of Debian, so the page is not built")
  return()
endif()

set(SPLATBUS_WEB "${CMAKE_BINARY_DIR}/share/splatbus/web")
file(GLOB_RECURSE sources CONFIGURE_DEPENDS "${web}/src/*.ts" "${web}/src/*.glsl" "${web}/static/*")
list(APPEND sources "${web}/build.mjs" "${web}/tsconfig.json" "${web}/package-lock.json" "${web}/wasm/instantiate.mjs")
add_custom_command(
  OUTPUT "${SPLATBUS_WEB}/app.js"
  COMMAND "${SPLATBUS_NODE}" build.mjs "${SPLATBUS_WEB}"
  WORKING_DIRECTORY "${web}"
  DEPENDS ${sources}
  COMMENT "Bundling the page"
  VERBATIM)
add_custom_command(
  OUTPUT "${SPLATBUS_WEB}/splatbus.wasm"
  COMMAND "${CMAKE_COMMAND}" -E copy "${SPLATBUS_WASM}" "${SPLATBUS_WEB}/splatbus.wasm"
  DEPENDS splatbus_wasm "${SPLATBUS_WASM}"
  VERBATIM)
add_custom_target(splatbus_web ALL DEPENDS "${SPLATBUS_WEB}/app.js" "${SPLATBUS_WEB}/splatbus.wasm")
