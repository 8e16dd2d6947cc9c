// SPDX-License-Identifier: Apache-2.0
// Compiles the implementation of volk, which loads the Vulkan loader at run time.
// Therefore the program can start without a Vulkan loader and report that it is missing.
#include <volk.c>
