// SPDX-License-Identifier: Apache-2.0
// Compute kernels. A program can run its own kernels on the arrays of relidar:
// Kernel::from_spirv() loads a kernel, and run() records a launch. The GLSL source of
// such a kernel includes relidar/base/kernel.glsl (tools/examples/robust_loss.comp).
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/gpu/stream.hpp>

namespace relidar {

enum class SpecialisationConstantId : std::uint32_t;

struct SpecialisationConstant {
    SpecialisationConstantId id;
    std::uint32_t value;
};

using KernelConstants = std::vector<SpecialisationConstant>;

/// Kernels that compute thread indices from subgroups require full subgroups, because
/// some compilers choose smaller ones.
enum class SubgroupRequirement { any, full };

// Names of kernels that the library contains. Only src/gpu/kernel.hpp defines them.
template <class Params>
class KernelName;
struct KernelVariant;

/// Compute pipeline. Uses the device's default workgroup size unless a constant sets the
/// size. The device must outlive the kernel.
class KernelBase {
public:
    /// On a GPU, another thread starts to compile the pipeline, on a CPU device the first
    /// launch. If the driver rejects the kernel, the first launch throws a DeviceError.
    KernelBase(Device& device, std::string_view kernel_name, const KernelConstants& constants = {},
               SubgroupRequirement subgroups = {});
    /// Creates a kernel of a program. See Kernel::from_spirv().
    /// @param params_bytes size of the parameter struct in C++
    KernelBase(Device& device, std::span<const std::uint32_t> spirv_words, const std::string& kernel_name,
               std::size_t params_bytes);
    ~KernelBase();

    struct Impl;
    /// Returns the internal implementation. Only the library uses this function.
    Impl& impl() const { return *impl_; }

private:
    std::unique_ptr<Impl> impl_;

    void start_compilation(Device& device, const KernelConstants& constants);
    void compile_pipeline();
};

/// Reads a SPIR-V module.
/// @throws DataError if the file cannot be read or its size is not a multiple of 4 bytes
std::vector<std::uint32_t> read_spirv(const std::filesystem::path& file);

/// Kernel whose parameter struct is Params. C++ and GLSL share the definition of this
/// struct (relidar/base/lang.h).
template <class Params>
class Kernel : public KernelBase {
public:
    /// Creates a kernel from a SPIR-V module, for example from the output of
    ///   glslangValidator --target-env vulkan1.3 -I<prefix>/include -o x.spv x.comp
    /// The GLSL source must include relidar/base/kernel.glsl, declare its parameters with
    /// RELIDAR_PARAMS(Params) and have the function main(). The module must keep its
    /// names (OpName). The device must have the features that the module uses. Every
    /// device has those of relidar/base/*.glsl.
    /// @param kernel_name name of the kernel in messages and in kernel times
    /// @throws DataError if the module is not SPIR-V up to version 1.6, is truncated, has
    /// no compute entry point main(), or does not use the interface of kernel.glsl
    /// @throws UsageError if the parameter struct of the module has another size than
    /// Params
    static Kernel from_spirv(Device& device, std::span<const std::uint32_t> spirv_words,
                             const std::string& kernel_name) {
        return Kernel(device, spirv_words, kernel_name);
    }
    /// Creates a kernel from a file with a SPIR-V module. The name of the kernel is the
    /// name of the file.
    /// @throws errors of read_spirv()
    static Kernel from_spirv(Device& device, const std::filesystem::path& file) {
        return from_spirv(device, read_spirv(file), file.filename().string());
    }

    // Kernels that the library contains.
    Kernel(Device& device, KernelName<Params> name, const KernelConstants& constants = {},
           SubgroupRequirement subgroups = {});
    Kernel(Device& device, KernelName<Params> name, const KernelVariant& variant,
           const KernelConstants& constants = {}, SubgroupRequirement subgroups = {});

private:
    Kernel(Device& device, std::span<const std::uint32_t> spirv_words, const std::string& kernel_name)
        : KernelBase(device, spirv_words, kernel_name, sizeof(Params)) {}
};

/// Records a launch. run() is the typed interface.
void record_launch(Stream& stream, const KernelBase& kernel, std::uint32_t n_threads, const void* params,
                   std::size_t params_bytes);

/// Records a launch of a kernel with at least n_threads threads: the last workgroup may
/// have additional threads. The parameters are copied now. The arrays to which they point
/// must exist until the submission with this launch is done.
template <class Params>
void run(Stream& stream, const Kernel<Params>& kernel, std::size_t n_threads, const Params& params) {
    if (n_threads)
        record_launch(stream, kernel, static_cast<std::uint32_t>(n_threads), &params, sizeof(Params));
}

}  // namespace relidar
