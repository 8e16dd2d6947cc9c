// SPDX-License-Identifier: Apache-2.0
// Compiles the implementation of volk, which loads Vulkan at run time. Therefore the
// program can start without a Vulkan loader and report that the loader is missing.
#include <volk.c>
