// SPDX-License-Identifier: Apache-2.0
// Compiles the implementation of volk. The library does not link the Vulkan loader, so
// that the program starts without a loader and can report that it is missing.
#include <volk.c>
