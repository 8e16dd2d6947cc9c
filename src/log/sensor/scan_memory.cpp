// SPDX-License-Identifier: Apache-2.0
// Stores the arrays of scans in a memory-mapped file if memory is short. The file is
// sparse and is mapped once, into an address range that is larger than any disk. The file
// grows with each new array. The space of freed arrays is returned to the disk and reused
// for other arrays.
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

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

namespace fs = std::filesystem;

// Smaller arrays (in bytes) are kept in memory, because each array in the file occupies
// complete pages.
constexpr std::size_t kSmall = 16 << 10;
constexpr std::size_t kReserved = std::size_t(1) << 40;  // Size of the reserved address range in bytes.

std::size_t round_to_pages(std::size_t bytes) {
    static const auto page = std::size_t(::sysconf(_SC_PAGESIZE));
    return (bytes + page - 1) / page * page;
}

[[noreturn]] void fail_to_make_room(const fs::path& folder, std::size_t bytes, int error) {
    throw DataError(
        fmt::format("cannot store scans that do not fit into memory in '{}': {} ({} more bytes are needed; "
                    "set TMPDIR to a folder with enough space, or increase dataset.memory_mib to keep more "
                    "scans in memory)",
                    folder.string(), std::generic_category().message(error), bytes));
}

/// Memory-mapped file without a name, which provides memory for arrays.
class MappedFile {
public:
    explicit MappedFile(fs::path folder) : folder_(std::move(folder)) {
        std::string name = (folder_ / "relidar-scans-XXXXXX").string();
        file_ = ::mkostemp(name.data(), O_CLOEXEC);
        if (file_ < 0) fail_to_make_room(folder_, 0, errno);
        ::unlink(name.c_str());
        void* begin =
            ::mmap(nullptr, kReserved, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_NORESERVE, file_, 0);
        if (begin == MAP_FAILED) {
            const int error = errno;
            ::close(file_);
            fail_to_make_room(folder_, 0, error);
        }
        begin_ = static_cast<std::byte*>(begin);
    }
    ~MappedFile() {
        ::munmap(begin_, kReserved);
        ::close(file_);
    }
    MappedFile(const MappedFile&) = delete;
    MappedFile& operator=(const MappedFile&) = delete;

    void* allocate(std::size_t bytes) {
        const std::size_t size = round_to_pages(bytes);
        const std::lock_guard lock(mutex_);
        const auto room =
            std::find_if(free_.begin(), free_.end(), [&](const auto& range) { return range.second >= size; });
        const std::size_t offset = room == free_.end() ? end_ : room->first;
        // Reserves the disk space now. Writing to a page would kill the process if the
        // disk were full later.
        if (const int error = ::posix_fallocate(file_, off_t(offset), off_t(size)); error != 0)
            fail_to_make_room(folder_, size, error);
        if (room == free_.end()) end_ += size;
        else {
            if (room->second > size) free_.emplace(offset + size, room->second - size);
            free_.erase(room);
        }
        used_ += size;
        return begin_ + offset;
    }

    bool holds(const void* array) const { return array >= begin_ && array < begin_ + kReserved; }

    void free(void* array, std::size_t bytes) noexcept {
        const std::size_t size = round_to_pages(bytes),
                          offset = std::size_t(static_cast<std::byte*>(array) - begin_);
        // Frees the disk space of the pages, if the file system supports this.
        ::fallocate(file_, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, off_t(offset), off_t(size));
        const std::lock_guard lock(mutex_);
        used_ -= size;
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

    std::uint64_t used() const { return used_; }

private:
    fs::path folder_;
    int file_ = -1;
    std::byte* begin_ = nullptr;
    std::size_t end_ = 0;                      ///< end of the used part of the file, in bytes
    std::map<std::size_t, std::size_t> free_;  ///< free ranges of the file: offset and size, in bytes
    std::atomic<std::uint64_t> used_ = 0;
    std::mutex mutex_;
};

struct Memory {
    std::atomic<std::uint64_t> limit = ~0ull, used = 0;
    std::atomic<MappedFile*> file = nullptr;
    std::atomic<int> processes = 1;
    std::mutex mutex;  ///< protects the members below
    fs::path folder;

    MappedFile& mapped() {
        if (MappedFile* made = file) return *made;
        const std::lock_guard lock(mutex);
        // The file is never closed, because arrays may be freed as late as the end of the
        // process.
        if (!file) file = std::make_unique<MappedFile>(folder).release();
        return *file;
    }
};

Memory& memory() {
    // Never destroyed, because static objects free their arrays after main().
    static Memory* const all = new Memory;
    return *all;
}

std::uint64_t get_machine_memory() {
    std::uint64_t bytes = std::uint64_t(::sysconf(_SC_PHYS_PAGES)) * std::uint64_t(::sysconf(_SC_PAGESIZE)),
                  limit = 0;
    // Files with the memory limit of the control group, in cgroup version 2 and version
    // 1.
    for (const char* file : {"/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"})
        // A file without a limit contains "max", so that reading a number fails.
        if (std::ifstream group(file); group >> limit) bytes = std::min(bytes, limit);
    return bytes;
}

}  // namespace

void limit_scan_memory(std::uint64_t bytes, const fs::path& folder) {
    Memory& m = memory();
    const std::lock_guard lock(m.mutex);
    m.folder = folder;
    m.limit = bytes > 0 ? bytes : get_machine_memory() / 2 / std::uint64_t(m.processes);
}

void set_scan_process_count(int n_processes) { memory().processes = std::max(n_processes, 1); }

ScanMemoryUse get_scan_memory_use() {
    const MappedFile* file = memory().file;
    return {memory().used, file ? file->used() : 0};
}

void* allocate_scan_array(std::size_t bytes) {
    if (bytes < kSmall) return ::operator new(bytes);
    Memory& m = memory();
    if (m.used.fetch_add(bytes) + bytes > m.limit) {
        m.used -= bytes;
        return m.mapped().allocate(bytes);
    }
    try {
        return ::operator new(bytes);
    } catch (...) {
        m.used -= bytes;
        throw;
    }
}

void free_scan_array(void* array, std::size_t bytes) noexcept {
    Memory& m = memory();
    MappedFile* file = m.file;
    if (bytes >= kSmall && file && file->holds(array)) return file->free(array, bytes);
    if (bytes >= kSmall) m.used -= bytes;
    ::operator delete(array);
}

}  // namespace relidar
