// SPDX-License-Identifier: Apache-2.0
// Functions and structs of Vulkan. Private to the library.
#pragma once

#include <volk.h>

#if defined(__GNUC__)
// Disables a warning about missing initialisers. Vulkan structs are initialised with
// {sType} and then filled member by member.
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
#endif
