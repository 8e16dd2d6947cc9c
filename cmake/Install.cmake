# SPDX-License-Identifier: Apache-2.0
# `cmake --install`: installs the static library with its headers, the command line
# program, and the files that find_package(relidar) reads.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

set(RELIDAR_PACKAGE_DIR ${CMAKE_INSTALL_LIBDIR}/cmake/relidar)

install(TARGETS relidar EXPORT relidarTargets
    ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}
    INCLUDES DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(DIRECTORY ${PROJECT_SOURCE_DIR}/include/relidar DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(EXPORT relidarTargets NAMESPACE relidar:: DESTINATION ${RELIDAR_PACKAGE_DIR})
install(FILES ${PROJECT_SOURCE_DIR}/third_party/Dependencies.cmake DESTINATION ${RELIDAR_PACKAGE_DIR} RENAME relidarDependencies.cmake)
configure_package_config_file(${PROJECT_SOURCE_DIR}/cmake/relidarConfig.cmake.in ${PROJECT_BINARY_DIR}/relidarConfig.cmake
    INSTALL_DESTINATION ${RELIDAR_PACKAGE_DIR})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/relidarConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/relidarConfig.cmake ${PROJECT_BINARY_DIR}/relidarConfigVersion.cmake DESTINATION ${RELIDAR_PACKAGE_DIR})
install(FILES ${PROJECT_SOURCE_DIR}/LICENSE DESTINATION ${CMAKE_INSTALL_DOCDIR})
# The installed headers include these headers.
install(DIRECTORY ${PROJECT_SOURCE_DIR}/docs DESTINATION ${CMAKE_INSTALL_DOCDIR} FILES_MATCHING PATTERN "*.md" PATTERN images EXCLUDE)

if(TARGET relidar_serve)   # Clients generate their stubs from these files.
    install(FILES ${PROJECT_SOURCE_DIR}/tools/serve/relidar/v1/render.proto DESTINATION ${CMAKE_INSTALL_DATADIR}/relidar/proto/relidar/v1)
    install(FILES ${PROJECT_SOURCE_DIR}/tools/serve/sensorsim/sensorsim.proto
            DESTINATION ${CMAKE_INSTALL_DATADIR}/relidar/proto/sensorsim)
endif()

if(RELIDAR_BUILD_TOOLS)
    get_property(RELIDAR_TOOL_TARGETS DIRECTORY ${PROJECT_SOURCE_DIR}/tools/relidar PROPERTY BUILDSYSTEM_TARGETS)
    foreach(tool IN LISTS RELIDAR_TOOL_TARGETS)
        get_target_property(type ${tool} TYPE)
        if(type STREQUAL "EXECUTABLE")
            install(TARGETS ${tool} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
        endif()
    endforeach()
endif()
