# find_package(mipbake) offers functions that bake textures in a CMake build. `mipbake --cmake-dir` prints where this
# file lies. The functions need CMake 3.20 and a generator that takes depfiles: Ninja or Makefiles.
cmake_minimum_required(VERSION 3.20)

# As a script of a build: the rule in a depfile is about what its command makes, a stamp, and no longer about results.
if(CMAKE_SCRIPT_MODE_FILE)
    file(READ "${depfile}" rule)
    string(FIND "${rule}" "\n" end)
    string(SUBSTRING "${rule}" ${end} -1 sources)
    string(REPLACE " " "\\ " stamp "${stamp}")
    file(WRITE "${depfile}" "${stamp}: \\${sources}")
    return()
endif()

find_program(MIPBAKE_EXECUTABLE mipbake REQUIRED DOC "The command mipbake")

# mipbake_bake(NAME SOURCE OUT [options of `mipbake bake` ...])
#
# A target NAME, built with all others, that bakes one texture set into OUT/<set>/. <set> is called as SOURCE is, or as
# the option SET says. SOURCE is relative to the current source folder, OUT to the current binary folder.
function(mipbake_bake name source out)
    cmake_parse_arguments(PARSE_ARGV 3 arg "" "SET" "")
    cmake_path(ABSOLUTE_PATH source BASE_DIRECTORY "${CMAKE_CURRENT_SOURCE_DIR}" NORMALIZE)
    cmake_path(ABSOLUTE_PATH out BASE_DIRECTORY "${CMAKE_CURRENT_BINARY_DIR}" NORMALIZE)
    if(source MATCHES "\\.(glb|gltf|mtlx)$")
        message(FATAL_ERROR "mipbake_bake is for texture sets, and ${source} is a document: use mipbake_bake_library")
    endif()
    if(NOT arg_SET)
        file(REAL_PATH "${source}" source_itself)  # links are called as what they lead to
        if(IS_DIRECTORY "${source}")
            cmake_path(GET source_itself FILENAME arg_SET)
        else()
            cmake_path(GET source_itself STEM LAST_ONLY arg_SET)
        endif()
        if(arg_SET MATCHES "[^ -~]")
            message(FATAL_ERROR "mipbake_bake cannot tell what the result of ${source} is called: name it, with SET")
        endif()
        string(REGEX REPLACE "[^A-Za-z0-9_.-]+" "_" arg_SET "${arg_SET}")
        string(REGEX REPLACE "^[._-]+|[._-]+$" "" arg_SET "${arg_SET}")
    endif()
    set(result "${out}/${arg_SET}/stack.json")
    set(depfile "${CMAKE_CURRENT_BINARY_DIR}/${name}.d")
    add_custom_command(
        OUTPUT "${result}"
        DEPFILE "${depfile}"
        DEPENDS "${MIPBAKE_EXECUTABLE}"
        COMMAND "${MIPBAKE_EXECUTABLE}" bake "${source}" -o "${out}" --depfile "${depfile}" --quiet ${arg_UNPARSED_ARGUMENTS}
        COMMENT "Baking ${name}"
        VERBATIM)
    add_custom_target("${name}" ALL DEPENDS "${result}")
endfunction()

# mipbake_bake_library(NAME LIBRARY OUT [options of `mipbake bake` ...])
#
# A target NAME, built with all others, that bakes everything below a folder which has changed.
function(mipbake_bake_library name library out)
    cmake_path(ABSOLUTE_PATH library BASE_DIRECTORY "${CMAKE_CURRENT_SOURCE_DIR}" NORMALIZE)
    cmake_path(ABSOLUTE_PATH out BASE_DIRECTORY "${CMAKE_CURRENT_BINARY_DIR}" NORMALIZE)
    set(stamp "${CMAKE_CURRENT_BINARY_DIR}/${name}.stamp")
    set(depfile "${CMAKE_CURRENT_BINARY_DIR}/${name}.d")
    add_custom_command(
        OUTPUT "${stamp}"
        DEPFILE "${depfile}"
        DEPENDS "${MIPBAKE_EXECUTABLE}"
        COMMAND "${MIPBAKE_EXECUTABLE}" bake "${library}" -o "${out}" --recursive --depfile "${depfile}"
                --quiet ${ARGN}
        COMMAND "${CMAKE_COMMAND}" "-Dstamp=${stamp}" "-Ddepfile=${depfile}" -P "${CMAKE_CURRENT_FUNCTION_LIST_FILE}"
        COMMAND "${CMAKE_COMMAND}" -E touch "${stamp}"
        COMMENT "Baking the library ${name}"
        VERBATIM)
    add_custom_target("${name}" ALL DEPENDS "${stamp}")
endfunction()
