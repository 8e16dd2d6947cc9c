// SPDX-License-Identifier: Apache-2.0
// What images are kept as, by name, by device and by kernel.
#include "refine/tensor.hpp"

#include <optional>

#include <fmt/format.h>

#include <relidar/error.hpp>

namespace relidar::refine {

Storage find_storage(const std::string& name) {
    const std::optional<std::string> known = known_name(name, {"fp32", "fp16"});
    if (!known) throw UsageError(fmt::format("refine.storage: found \"{}\", expected fp32 or fp16", name));
    return known == "fp16" ? Storage::fp16 : Storage::fp32;
}

Storage checked(const Device& device, Storage storage) {
    const DeviceInfo& info = device.info();
    if (storage == Storage::fp16 && !info.why_not_halves.empty())
        throw DeviceError(fmt::format("making the ray-drop network with refine.storage=fp16 on {}: missing {}; set refine.storage=fp32",
                                      info.name, info.why_not_halves));
    return storage;
}

KernelVariant image_variant(Storage storage) { return KernelVariant(storage == Storage::fp16 ? "@halves" : ""); }

}  // namespace relidar::refine
