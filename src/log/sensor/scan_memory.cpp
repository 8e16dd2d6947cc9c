// SPDX-License-Identifier: Apache-2.0
// Stores the arrays of scans in a memory-mapped file if memory is short. The file is
// sparse and is mapped once, into an address range that is larger than any disk. The file
// grows with each new array. The space of freed arrays is reused, or returned to the file
// system.
#include <relidar/log/sensor.hpp>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <map>
#include <memory>
#include <mutex>
#include <new>
#include <string>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

// Smaller arrays stay in memory, because each array in the file starts a new page.
constexpr std::size_t kMinCountedBytes = 16 << 10;
constexpr std::size_t kReservedBytes = std::size_t(1) << 40;  // Size of the reserved address range in bytes.

std::size_t round_to_page(std::size_t bytes) {
    static const auto page = std::size_t(::sysconf(_SC_PAGESIZE));
    return (bytes + page - 1) / page * page;
}

[[noreturn]] void fail_storage(const fs::path& folder, std::size_t missing_bytes, int error) {
    fail(
        "the scans do not fit into memory, and relidar cannot store the remainder in the folder '{}': {} "
        "({}set TMPDIR to a folder with enough space, or increase dataset.memory_mib to keep more scans in "
        "memory)",
        folder.string(), std::generic_category().message(error),
        missing_bytes > 0 ? fmt::format("{} more bytes are needed; ", missing_bytes) : "");
}

/// A file without a name, mapped to memory. Its parts are used as memory for arrays.
class MappedFile {
public:
    explicit MappedFile(fs::path folder) : folder_(std::move(folder)) {
        std::string name = (folder_ / "relidar-scans-XXXXXX").string();
        file_ = ::mkostemp(name.data(), O_CLOEXEC);
        if (file_ < 0) fail_storage(folder_, 0, errno);
        // The file has no name from now on, so the system deletes it in any case.
        ::unlink(name.c_str());
        // Maps the final size, so that arrays keep their addresses when the file grows.
        void* begin =
            ::mmap(nullptr, kReservedBytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_NORESERVE, file_, 0);
        if (begin == MAP_FAILED) {
            const int error = errno;
            ::close(file_);
            fail_storage(folder_, 0, error);
        }
        begin_ = static_cast<std::byte*>(begin);
    }
    ~MappedFile() {
        ::munmap(begin_, kReservedBytes);
        ::close(file_);
    }
    MappedFile(const MappedFile&) = delete;
    MappedFile& operator=(const MappedFile&) = delete;

    void* allocate_block(std::size_t bytes) {
        const std::size_t size = round_to_page(bytes);
        const std::lock_guard lock(mutex_);
        const auto free_range =
            std::find_if(free_.begin(), free_.end(), [&](const auto& range) { return range.second >= size; });
        const std::size_t offset = free_range == free_.end() ? end_ : free_range->first;
        // Reserves the disk space now, because a write to a mapped page kills the process
        // if the disk is full.
        if (const int error = ::posix_fallocate(file_, off_t(offset), off_t(size)); error != 0)
            fail_storage(folder_, size, error);
        if (free_range == free_.end()) end_ += size;
        else {
            if (free_range->second > size) free_.emplace(offset + size, free_range->second - size);
            free_.erase(free_range);
        }
        used_ += size;
        return begin_ + offset;
    }

    bool has_address(const void* address) const {
        return address >= begin_ && address < begin_ + kReservedBytes;
    }

    void free_block(void* block_address, std::size_t bytes) noexcept {
        const std::size_t size = round_to_page(bytes),
                          offset = std::size_t(static_cast<std::byte*>(block_address) - begin_);
        // Frees the disk space, if the file system can make holes.
        ::fallocate(file_, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, off_t(offset), off_t(size));
        const std::lock_guard lock(mutex_);
        used_ -= size;
        // Joins the free range with its free neighbours, so that larger arrays fit again.
        auto [range, is_new] = free_.emplace(offset, size);
        if (const auto next = std::next(range); next != free_.end() && offset + size == next->first) {
            range->second += next->second;
            free_.erase(next);
        }
        if (range == free_.begin()) return;
        if (const auto before = std::prev(range); before->first + before->second == offset) {
            before->second += range->second;
            free_.erase(range);
        }
    }

    std::uint64_t used_bytes() const { return used_; }

private:
    fs::path folder_;
    int file_ = -1;
    std::byte* begin_ = nullptr;
    std::size_t end_ = 0;                      ///< end of the used part of the file, in bytes
    std::map<std::size_t, std::size_t> free_;  ///< free ranges of the file: offset and size, in bytes
    std::atomic<std::uint64_t> used_ = 0;
    std::mutex mutex_;
};

struct ScanMemoryState {
    std::atomic<std::uint64_t> limit = ~0ull, used = 0;
    std::atomic<MappedFile*> file = nullptr;
    std::atomic<int> processes = 1;
    std::mutex mutex;  ///< protects the members below
    fs::path folder;

    MappedFile& mapped_file() {
        if (MappedFile* made = file) return *made;
        const std::lock_guard lock(mutex);
        // The file stays open until the process ends, because static objects may free
        // arrays after main().
        if (!file) file = std::make_unique<MappedFile>(folder).release();
        return *file;
    }
};

ScanMemoryState& memory_state() {
    // Never destroyed, for the same reason.
    static ScanMemoryState* const all = new ScanMemoryState;
    return *all;
}

std::uint64_t physical_bytes() {
    std::uint64_t bytes = std::uint64_t(::sysconf(_SC_PHYS_PAGES)) * std::uint64_t(::sysconf(_SC_PAGESIZE)),
                  limit = 0;
    // control group: version 2, then version 1
    for (const char* file : {"/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"})
        // Without a limit, the file contains "max".
        if (std::ifstream group(file); group >> limit) bytes = std::min(bytes, limit);
    return bytes;
}

}  // namespace

void limit_scan_memory(std::uint64_t max_bytes, fs::path overflow_folder) {
    std::error_code failed;
    if (overflow_folder.empty()) overflow_folder = fs::temp_directory_path(failed);
    if (failed) overflow_folder = "/tmp";
    ScanMemoryState& m = memory_state();
    const std::lock_guard lock(m.mutex);
    m.folder = std::move(overflow_folder);
    m.limit = max_bytes > 0 ? max_bytes : physical_bytes() / 2 / std::uint64_t(m.processes);
}

void share_scan_memory(int n_processes) { memory_state().processes = std::max(n_processes, 1); }

ScanMemoryUse scan_memory_use() {
    const MappedFile* file = memory_state().file;
    return {memory_state().used, file ? file->used_bytes() : 0};
}

void* allocate_array(std::size_t bytes) {
    if (bytes < kMinCountedBytes) return ::operator new(bytes);
    ScanMemoryState& memory = memory_state();
    // Adds first and compares later, so that concurrent calls cannot exceed the limit.
    if (memory.used.fetch_add(bytes) + bytes > memory.limit) {
        memory.used -= bytes;
        return memory.mapped_file().allocate_block(bytes);
    }
    try {
        return ::operator new(bytes);
    } catch (...) {
        memory.used -= bytes;
        throw;
    }
}

void free_scan_array(void* array, std::size_t bytes) noexcept {
    ScanMemoryState& m = memory_state();
    MappedFile* file = m.file;
    if (bytes >= kMinCountedBytes && file && file->has_address(array)) return file->free_block(array, bytes);
    if (bytes >= kMinCountedBytes) m.used -= bytes;
    ::operator delete(array);
}

}  // namespace relidar
