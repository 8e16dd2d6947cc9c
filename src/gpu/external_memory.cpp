// SPDX-License-Identifier: Apache-2.0
// Imports blocks of device memory into CUDA or HIP. Both have the same functions and
// structs with different names.
#include "gpu/external_memory.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <mutex>

#include <dlfcn.h>
#include <unistd.h>

#include "base/fail.hpp"

namespace relidar::gpu {

namespace {

constexpr VkExternalMemoryHandleTypeFlagBits kHandleType = VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT;
constexpr int kOpaqueFd = 1;  // CU_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD, and the same of HIP

/// Layout of CUDA_EXTERNAL_MEMORY_HANDLE_DESC and hipExternalMemoryHandleDesc.
struct ImportDescription {
    int type = kOpaqueFd;
    union {
        int fd;
        void* pointers[2];
    } handle{};
    unsigned long long size = 0;
    unsigned flags = 0, reserved[16]{};
};
/// Layout of CUDA_EXTERNAL_MEMORY_BUFFER_DESC and hipExternalMemoryBufferDesc.
struct MappingDescription {
    unsigned long long offset = 0, size = 0;
    unsigned flags = 0, reserved[16]{};
};

struct LibraryNames {
    std::uint32_t vendor_id;
    MemoryAddress::Interface interface;
    const char* file;
    std::array<const char*, 11> functions;  ///< in the order of ComputeLibrary
};
constexpr LibraryNames kLibraries[] = {
    {0x10de,
     MemoryAddress::Interface::cuda,
     "libcuda.so.1",
     {"cuInit", "cuDeviceGetCount", "cuDeviceGet", "cuDeviceGetUuid", "cuDevicePrimaryCtxRetain",
      "cuCtxPushCurrent_v2", "cuCtxPopCurrent_v2", "cuImportExternalMemory",
      "cuExternalMemoryGetMappedBuffer", "cuMemFree_v2", "cuDestroyExternalMemory"}},
    {0x1002,
     MemoryAddress::Interface::hip,
     "libamdhip64.so",
     {"hipInit", "hipGetDeviceCount", "hipDeviceGet", "hipDeviceGetUuid", "hipDevicePrimaryCtxRetain",
      "hipCtxPushCurrent", "hipCtxPopCurrent", "hipImportExternalMemory", "hipExternalMemoryGetMappedBuffer",
      "hipFree", "hipDestroyExternalMemory"}}};

struct ComputeLibrary {
    int (*init)(unsigned);
    int (*count_devices)(int* n);
    int (*get_device)(int* device, int index);
    int (*get_uuid)(std::uint8_t* uuid, int device);
    int (*retain_context)(void** context, int device);
    int (*push_context)(void* context);
    int (*pop_context)(void** context);
    int (*import_memory)(void** memory, const ImportDescription* description);
    int (*map_memory)(std::byte** pointer, void* memory, const MappingDescription* description);
    int (*free_mapping)(std::byte* pointer);
    int (*destroy_memory)(void* memory);
    const LibraryNames* names = nullptr;

    void check(int result, std::size_t function) const {
        if (result != 0)
            fail<DeviceError>("{} failed: it returned {}, expected 0", names->functions[function], result);
    }
};

/// Loads the functions of a library. They stay loaded until the process ends.
/// @return the functions, or null if the library or one of its functions is missing
const ComputeLibrary* load_library(const LibraryNames& names) {
    void* library = dlopen(names.file, RTLD_NOW | RTLD_LOCAL);
    if (!library) return nullptr;
    auto loaded = std::make_unique<ComputeLibrary>();
    ComputeLibrary& l = *loaded;
    l.names = &names;
    const std::array<void*, 11> pointers{
        &l.init,        &l.count_devices, &l.get_device, &l.get_uuid,     &l.retain_context, &l.push_context,
        &l.pop_context, &l.import_memory, &l.map_memory, &l.free_mapping, &l.destroy_memory};
    for (std::size_t i = 0; i < pointers.size(); ++i) {
        void* const function = dlsym(library, names.functions[i]);
        if (!function) return nullptr;
        std::memcpy(pointers[i], &function, sizeof function);
    }
    constexpr unsigned kNoFlags = 0;
    return l.init(kNoFlags) == 0 ? loaded.release() : nullptr;
}

/// Returns the library of a vendor, or null if it has none or another vendor's library is
/// loaded. A process uses cards of one vendor, so only one library is loaded.
const ComputeLibrary* find_library(std::uint32_t vendor_id) {
    const auto names = std::ranges::find(kLibraries, vendor_id, &LibraryNames::vendor_id);
    if (names == std::end(kLibraries)) return nullptr;
    static const ComputeLibrary* const kLoaded = load_library(*names);
    return kLoaded && kLoaded->names == names ? kLoaded : nullptr;
}

/// Returns the library's index of the device that has the UUID of the Vulkan device.
int find_device(const ComputeLibrary& library, const Device::Impl& device) {
    VkPhysicalDeviceIDProperties id{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ID_PROPERTIES};
    VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, &id};
    vkGetPhysicalDeviceProperties2(device.physical, &properties);
    // The second argument of check() is an index in LibraryNames::functions.
    int n_devices = 0;
    library.check(library.count_devices(&n_devices), 1);
    for (int index = 0; index < n_devices; ++index) {
        int handle = 0;
        std::uint8_t uuid[VK_UUID_SIZE];
        library.check(library.get_device(&handle, index), 2);
        library.check(library.get_uuid(uuid, handle), 3);
        if (std::memcmp(uuid, id.deviceUUID, VK_UUID_SIZE) == 0) return index;
    }
    fail<DeviceError>(
        "cannot share memory of {} with {}: none of its {} devices has the UUID of this card; make the card "
        "visible to it, or open the device without shared memory",
        device.info.name, library.names->file, n_devices);
}

/// Memory that a library has imported, in the context of its device. All functions of the
/// library return 0 if they succeed.
struct ImportedBlock {
    const ComputeLibrary& library;
    int device_index, device = 0;
    void *context = nullptr, *memory = nullptr;
    std::byte* pointer = nullptr;

    ImportedBlock(const ComputeLibrary& importer, const Device::Impl& owner, const MemoryBlock& block)
        : library(importer), device_index(find_device(importer, owner)) {
        library.check(library.get_device(&device, device_index), 2);
        library.check(library.retain_context(&context, device), 4);
        ImportDescription import;
        import.size = block.n_bytes;
        import.handle.fd = export_block(owner, block);
        const int pushed = library.push_context(context);
        if (pushed != 0) close(import.handle.fd);
        library.check(pushed, 5);
        const int imported = library.import_memory(&memory, &import);
        if (imported != 0) close(import.handle.fd);  // otherwise the library closes it
        MappingDescription mapping;
        mapping.size = block.n_bytes;
        const int mapped = imported ? imported : library.map_memory(&pointer, memory, &mapping);
        if (!imported && mapped) library.destroy_memory(memory);
        library.pop_context(&context);  // before the checks, which may throw
        library.check(imported, 7);
        library.check(mapped, 8);
    }
    ~ImportedBlock() {
        library.push_context(context);
        library.free_mapping(pointer);
        library.destroy_memory(memory);
        library.pop_context(&context);
    }
    ImportedBlock(const ImportedBlock&) = delete;
    ImportedBlock& operator=(const ImportedBlock&) = delete;
};

}  // namespace

/// Returns true if the device can export the memory of buffers as file descriptors.
bool can_export(VkPhysicalDevice physical, bool binds_sparse) {
    if (!has_extension(physical, VK_KHR_EXTERNAL_MEMORY_FD_EXTENSION_NAME)) return false;
    VkPhysicalDeviceExternalBufferInfo info{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_EXTERNAL_BUFFER_INFO};
    info.flags = binds_sparse ? VK_BUFFER_CREATE_SPARSE_BINDING_BIT : 0;
    info.usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT |
                 VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
    info.handleType = kHandleType;
    VkExternalBufferProperties properties{VK_STRUCTURE_TYPE_EXTERNAL_BUFFER_PROPERTIES};
    vkGetPhysicalDeviceExternalBufferProperties(physical, &info, &properties);
    const VkExternalMemoryFeatureFlags features = properties.externalMemoryProperties.externalMemoryFeatures;
    // relidar puts several buffers into a block, which is not allowed if each needs a
    // dedicated allocation.
    return (features & VK_EXTERNAL_MEMORY_FEATURE_EXPORTABLE_BIT) &&
           !(features & VK_EXTERNAL_MEMORY_FEATURE_DEDICATED_ONLY_BIT);
}

int export_block(const Device::Impl& device, const MemoryBlock& block) {
    VkMemoryGetFdInfoKHR info{VK_STRUCTURE_TYPE_MEMORY_GET_FD_INFO_KHR};
    info.memory = block.memory;
    info.handleType = kHandleType;
    int fd = -1;
    vk_check(vkGetMemoryFdKHR(device.device, &info, &fd), "vkGetMemoryFdKHR");
    return fd;
}

MemoryAddress import_block(const Device::Impl& device, MemoryBlock& block) {
    const ComputeLibrary* library = find_library(device.info.vendor_id);
    if (!library) return {};
    static std::mutex mutex;
    const std::lock_guard lock(mutex);
    if (!block.imported) block.imported = std::make_shared<ImportedBlock>(*library, device, block);
    const auto& imported = *static_cast<const ImportedBlock*>(block.imported.get());
    return {library->names->interface, imported.pointer, imported.device_index};
}

}  // namespace relidar::gpu
