# SPDX-License-Identifier: Apache-2.0
# `cpack` makes a Debian package of all files that `cmake --install` installs:
# build/<preset>/package/relidar_<version>_<arch>.deb.
# One package contains both the program and the library, although Debian would separate
# relidar and librelidar-dev. The library is static, and the packages that are needed to
# compile against it are recommended packages. `apt install` installs them; --no-install-
# recommends does not.
# With SOURCE_DATE_EPOCH set, the same build produces the same bytes.
find_program(RELIDAR_DPKG dpkg)
if(NOT RELIDAR_DPKG)
    return()   # Not a Debian system.
endif()

# Debian packages of the libraries that our targets link. Their code may be part of the
# program. Programs that link our library need the packages in `to_link`.
set(compiled_in "")
set(to_link "")
foreach(target IN ITEMS relidar relidar_commands relidar_cli relidar_view_server relidar_serve relidar_python)
    set(libraries "")
    if(TARGET ${target})
        get_target_property(libraries ${target} LINK_LIBRARIES)
        list(FILTER libraries INCLUDE REGEX "^relidar::dep_")
    endif()
    foreach(library IN LISTS libraries)
        get_target_property(package ${library} RELIDAR_DEBIAN_PACKAGE)
        get_target_property(build_only ${library} RELIDAR_BUILD_ONLY)
        list(APPEND compiled_in ${package})
        if(NOT build_only)
            list(APPEND to_link ${package})
        endif()
    endforeach()
endforeach()
list(REMOVE_DUPLICATES compiled_in)
list(REMOVE_DUPLICATES to_link)

# Our licence, followed by the licences of all code that may be compiled in, as stated by
# the packages used for this build.
set(copyright ${PROJECT_BINARY_DIR}/copyright)
configure_file(${PROJECT_SOURCE_DIR}/cmake/debian/copyright ${copyright} COPYONLY)
foreach(package IN LISTS compiled_in)
    if(EXISTS /usr/share/doc/${package}/copyright)
        file(READ /usr/share/doc/${package}/copyright text)
        file(APPEND ${copyright} "\n======== ${package} ========\n\n${text}")
    endif()
endforeach()
# -n: no time stamp in the file.
execute_process(COMMAND gzip -9nc ${PROJECT_SOURCE_DIR}/cmake/debian/changelog
    OUTPUT_FILE ${PROJECT_BINARY_DIR}/changelog.gz COMMAND_ERROR_IS_FATAL ANY)
install(FILES ${copyright} ${PROJECT_BINARY_DIR}/changelog.gz DESTINATION ${CMAKE_INSTALL_DOCDIR})

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_DIRECTORY ${PROJECT_BINARY_DIR}/package)
set(CPACK_PACKAGE_CONTACT "relidar maintainers <maintainers@relidar.invalid>")
set(CPACK_PACKAGE_DESCRIPTION
"Makes a scene of 2D Gaussians (surfels) from the scans of a driving log, and
new scans from it: from other places, for other sensors, with actors moved or
removed. Compute shaders with ray queries, or with a tree walked in software.
.
This package holds the program, the static library with its headers, what
find_package(relidar) reads, and the Python module relidar.")
set(CPACK_STRIP_FILES ON)
set(CPACK_PRE_BUILD_SCRIPTS ${PROJECT_SOURCE_DIR}/cmake/debian/permissions.cmake)

set(depends libvulkan1)   # Opened at run time, so that dpkg-shlibdeps does not find it.
if(RELIDAR_PYTHON)        # The module is built for one version of Python.
    math(EXPR next_minor "${Python_VERSION_MINOR} + 1")
    list(APPEND depends python3-numpy "python3 (>= ${Python_VERSION_MAJOR}.${Python_VERSION_MINOR})"
        "python3 (<< ${Python_VERSION_MAJOR}.${next_minor})")
endif()
# The first software driver that supports every kernel.
set(recommends "mesa-vulkan-drivers (>= 24.1)" ${to_link})
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
list(JOIN depends ", " CPACK_DEBIAN_PACKAGE_DEPENDS)
list(JOIN recommends ", " CPACK_DEBIAN_PACKAGE_RECOMMENDS)
include(CPack)
