# Build settings shared by all targets, and the three functions every room uses.

set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/bin)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()
set(CMAKE_CXX_FLAGS_RELEASE "-O3 -DNDEBUG")

find_program(EFFIGY_CCACHE ccache)
if(EFFIGY_CCACHE)
  set(CMAKE_CXX_COMPILER_LAUNCHER ${EFFIGY_CCACHE})
endif()

add_library(effigy_flags INTERFACE)
target_include_directories(effigy_flags INTERFACE ${PROJECT_SOURCE_DIR}/src)
# -Wrestrict: GCC 12 reports std::string concatenation falsely (GCC bug 105651).
target_compile_options(effigy_flags INTERFACE -Wall -Wextra -Wpedantic -Wshadow -Werror -Wno-restrict
                       -fno-math-errno)
target_compile_definitions(effigy_flags INTERFACE EFFIGY_VERSION="${PROJECT_VERSION}")
if(EFFIGY_SANITIZE)
  target_compile_options(effigy_flags INTERFACE -fsanitize=${EFFIGY_SANITIZE}
                         -fno-omit-frame-pointer -fno-sanitize-recover=all)
  target_link_options(effigy_flags INTERFACE -fsanitize=${EFFIGY_SANITIZE})
  # Checks make the vector kernels large: with all of Highway's targets and full optimisation one
  # file takes a quarter of an hour. The scalar and the widest common target stay.
  target_compile_options(effigy_flags INTERFACE -O1 -g1)
  target_compile_definitions(effigy_flags INTERFACE EFFIGY_SANITIZED=1
    "HWY_DISABLED_TARGETS=(HWY_SSSE3|HWY_SSE4|HWY_AVX3|HWY_AVX3_DL)")
endif()

# effigy_room(name SOURCES a.cpp ... DEPENDS target ...)
#   One folder under src/effigy, one static library effigy_<name>. DEPENDS names lower rooms
#   (effigy_base, ...) and outside libraries.
function(effigy_room name)
  cmake_parse_arguments(ROOM "" "" "SOURCES;DEPENDS" ${ARGN})
  if(ROOM_SOURCES)
    add_library(effigy_${name} STATIC ${ROOM_SOURCES})
    target_link_libraries(effigy_${name} PUBLIC effigy_flags ${ROOM_DEPENDS})
  else()
    add_library(effigy_${name} INTERFACE)
    target_link_libraries(effigy_${name} INTERFACE effigy_flags ${ROOM_DEPENDS})
  endif()
endfunction()

# effigy_test(room file DEPENDS ...)
#   Builds tests/<room>/<file>.cpp into one executable and registers it with CTest as <room>/<file>.
function(effigy_test room file)
  cmake_parse_arguments(TEST "" "TIMEOUT" "DEPENDS" ${ARGN})
  set(target test_${room}_${file})
  add_executable(${target} ${file}.cpp)
  target_include_directories(${target} PRIVATE ${PROJECT_SOURCE_DIR}/tests)
  target_link_libraries(${target} PRIVATE ${TEST_DEPENDS} GTest::gtest GTest::gtest_main)
  target_compile_definitions(${target} PRIVATE
    EFFIGY_SOURCE_DIR="${PROJECT_SOURCE_DIR}" EFFIGY_BINARY_DIR="${CMAKE_BINARY_DIR}")
  add_test(NAME ${room}/${file} COMMAND ${target})
  if(NOT TEST_TIMEOUT)
    set(TEST_TIMEOUT 300)
  endif()
  if(EFFIGY_SANITIZE)
    math(EXPR TEST_TIMEOUT "${TEST_TIMEOUT} * 6")  # checks cost that much
  endif()
  set_tests_properties(${room}/${file} PROPERTIES TIMEOUT ${TEST_TIMEOUT}
    ENVIRONMENT "TSAN_OPTIONS=suppressions=${PROJECT_SOURCE_DIR}/tests/tsan.supp")
endfunction()
