// SPDX-License-Identifier: Apache-2.0
// Device memory and kernel launches. The interface has no Vulkan types, so that other
// parts of relidar do not depend on Vulkan.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <relidar/base/lang.h>
#include <relidar/gpu/device.hpp>

namespace relidar {

/// Address of device memory for other libraries of this process.
struct MemoryAddress {
    /// Interface to which the address belongs: the host, CUDA or HIP. `none`: other
    /// libraries cannot reach the memory.
    enum class Interface { none, host, cuda, hip } interface = Interface::none;
    std::byte* pointer = nullptr;
    int device_index = 0;  ///< Index of the device in CUDA or HIP.
};

/// Block of device memory. It can be moved but not copied.
class Buffer {
public:
    Buffer();
    /// Allocates n_bytes of device memory.
    /// @param text name of the buffer in messages
    /// @throws OutOfDeviceMemory if device memory is exhausted. The message names the
    /// buffer, its size and the free memory.
    Buffer(Device& device, std::size_t n_bytes, const std::string& text);
    ~Buffer();
    Buffer(Buffer&&) noexcept;
    Buffer& operator=(Buffer&&) noexcept;

    std::size_t size_bytes() const;
    /// Returns another handle of the same memory, which is freed with its last handle.
    Buffer share() const;
    /// Returns the address with which other libraries use the memory without a copy: on a
    /// CPU device a host address, on NVIDIA and AMD cards an address of CUDA or HIP. The
    /// interface is `none` if DeviceOptions::share_memory is false or the device cannot
    /// share its memory. Work of the device must be complete before others read or write.
    /// @throws DeviceError if the library of the card fails
    MemoryAddress address_for_others() const;
    explicit operator bool() const { return impl_ != nullptr; }
    /// Copies data from the host to the device and waits until the copy is done.
    /// download() copies from the device to the host and also waits.
    /// @throws DeviceError if the device is lost
    void upload(const void* data, std::size_t n_bytes, std::size_t offset_bytes = 0);
    void download(void* data, std::size_t n_bytes, std::size_t offset_bytes = 0) const;
    /// Copies the first n_bytes of another buffer of the same device to this buffer.
    /// Waits until the copy is done.
    void copy_from(const Buffer& source, std::size_t n_bytes);

    struct Impl;
    /// Returns the internal implementation. Only the library uses this function.
    Impl& impl() const { return *impl_; }

private:
    template <class, class>
    friend class Array;
    std::shared_ptr<Impl> impl_;

    std::uint64_t device_address() const;
};

/// Array in device memory. T must be trivially copyable.
template <class T>
class Array<T, void> {
public:
    Array() = default;
    Array(Device& device, std::size_t count, const std::string& text)
        : buffer_(device, (count ? count : 1) * sizeof(T), text), n_(count) {}
    Array(Device& device, std::span<const T> values, const std::string& text)
        : Array(device, values.size(), text) {
        upload(values);
    }

    std::size_t size() const { return n_; }
    /// Returns the device address of entry `first_index`, to be passed to a kernel. The
    /// shader compiler assumes a multiple of 16 and may combine loads into 16-byte loads.
    /// It never combines atomics or loads at indices computed at run time. Therefore a
    /// kernel may use any other address only in these two ways.
    Address<T> address(std::size_t first_index = 0) const { return address_as<T>(first_index); }
    /// Returns the device address of entry `first_index` of this array, which has entries
    /// of type T. The kernel that gets the address reads the memory as type U instead.
    template <class U, class Meaning = void>
    Address<U, Meaning> address_as(std::size_t first_index = 0) const {
        static_assert(sizeof(T) % sizeof(U) == 0 || sizeof(U) % sizeof(T) == 0);
        return Address<U, Meaning>(buffer_.device_address() + first_index * sizeof(T));
    }
    const Buffer& buffer() const { return buffer_; }
    void upload(std::span<const T> values, std::size_t first_index = 0) {
        if (!values.empty()) buffer_.upload(values.data(), values.size_bytes(), first_index * sizeof(T));
    }
    std::vector<T> download() const { return download(n_); }
    /// Waits for the GPU and copies the first `count` values to the host.
    std::vector<T> download(std::size_t count) const {
        std::vector<T> values(count);
        if (count) buffer_.download(values.data(), count * sizeof(T));
        return values;
    }
    /// Enlarges the array to at least `count` values. Existing values are kept, and new
    /// values are undefined. The array never shrinks. The address of the array changes,
    /// so no submitted GPU work may use the array.
    /// @throws OutOfDeviceMemory if device memory is exhausted. The array is then
    /// unchanged.
    void reserve(Device& device, std::size_t count, const std::string& text) {
        if (count <= n_) return;
        Array larger_array(device, count, text);
        if (n_) larger_array.buffer_.copy_from(buffer_, n_ * sizeof(T));
        *this = std::move(larger_array);
    }

private:
    Buffer buffer_;
    std::size_t n_ = 0;
};

/// Device array whose type also names its content, for example Array<float,
/// shared::LossTerms>. It is a compile error to pass the array to a kernel parameter with
/// another content (RELIDAR_OF). On the host, the class behaves like Array<T>.
template <class T, class Meaning>
class Array : public Array<T> {
public:
    using Array<T>::Array;
    /// Returns the device address of an element. The type of the address includes
    /// Meaning, the tag type that names the content of this array.
    Address<T, Meaning> address(std::size_t first_index = 0) const {
        return this->template address_as<T, Meaning>(first_index);
    }
};

/// Returns the device address of an array, or a null address if the pointer is null.
template <class T, class Meaning>
Address<T, Meaning> address_or_null(const Array<T, Meaning>* array_or_null) {
    return array_or_null ? array_or_null->address() : Address<T, Meaning>();
}

/// Records GPU commands and submits them to the device. A kernel launch sees the results
/// of all earlier launches. There are two exceptions: launches in the same
/// ConcurrentLaunchScope, and launches in other lanes of a ConcurrentSequenceScope.
class Stream {
public:
    explicit Stream(Device& device, bool timing = false);
    ~Stream();

    /// Records a command that fills an array with a 32-bit pattern.
    void fill(const Buffer& buffer, std::uint32_t pattern = 0);
    template <class T>
    void fill(const Array<T>& array, std::uint32_t pattern = 0) {
        fill(array.buffer(), pattern);
    }
    /// Records a copy of the first n_bytes from one buffer to another buffer of the same
    /// device.
    void copy(const Buffer& source, const Buffer& target, std::size_t n_bytes);
    /// Submits the recorded commands to the GPU.
    /// @return ticket with which wait_for() waits for this submission
    std::uint64_t submit_commands();
    /// Waits until the submission with this ticket is done.
    /// @throws DeviceError if the device is lost or a check in a kernel failed. The
    /// message names the kernel.
    void wait_for(std::uint64_t ticket);
    /// Submits the recorded commands and waits until they are done.
    void submit_and_wait() { wait_for(submit_commands()); }
    /// Returns the kernel times measured so far. Times are measured only if timing = true
    /// and the device has timestamps.
    const KernelTimes& times() const;
    void reset_times();
    Device& device() const;

    struct Impl;
    /// Returns the internal implementation. Only the library uses this function.
    Impl& impl() const { return *impl_; }

private:
    std::unique_ptr<Impl> impl_;
};

/// Scope in which all recorded kernel launches may run concurrently. A launch must not
/// access memory that another launch of the scope writes. Commands recorded after the
/// scope see the results of all launches in the scope.
class ConcurrentLaunchScope {
public:
    explicit ConcurrentLaunchScope(Stream& stream);
    ~ConcurrentLaunchScope();
    ConcurrentLaunchScope(const ConcurrentLaunchScope&) = delete;
    ConcurrentLaunchScope& operator=(const ConcurrentLaunchScope&) = delete;

private:
    Stream& stream_;
};

/// Scope in which a stream records several independent sequences of kernel launches,
/// called lanes. A launch sees only the results of earlier launches in the same lane. The
/// n-th launches of all lanes may run concurrently, so that several small launches use
/// the full device. A launch must not access memory that another lane writes. Commands
/// recorded or submitted after the scope see the results of all lanes.
class ConcurrentSequenceScope {
public:
    ConcurrentSequenceScope(Stream& stream, std::size_t n_sequences);
    ~ConcurrentSequenceScope();
    ConcurrentSequenceScope(const ConcurrentSequenceScope&) = delete;
    ConcurrentSequenceScope& operator=(const ConcurrentSequenceScope&) = delete;
    /// Records the next launches in the sequence (lane) with this index. Until the first
    /// call, launches are recorded in sequence 0.
    void select_lane(std::size_t sequence_index);

private:
    Stream& stream_;
};

/// Copies device values to host memory without blocking. The copy runs with the next
/// submission of the stream.
class ReadbackBuffer {
public:
    /// Allocates host memory for the copied values.
    /// @param n_bytes maximum size of a copy
    /// @param text name of the copy in messages
    /// @throws DeviceError if memory is exhausted
    ReadbackBuffer(Device& device, std::size_t n_bytes, const std::string& text);
    ~ReadbackBuffer();
    ReadbackBuffer(ReadbackBuffer&&) noexcept;
    ReadbackBuffer& operator=(ReadbackBuffer&&) noexcept;

    /// Records a copy of n_bytes from the device into cached host memory. The next
    /// submit_commands() of the stream executes the copy.
    void record_copy(Stream& stream, const Buffer& source, std::size_t n_bytes, std::size_t offset_bytes = 0);
    /// Returns true if a copy was recorded but not yet read with wait_for_bytes().
    bool is_pending() const;
    /// Waits until the recorded copy is done.
    /// @return the copied bytes, valid until the next record_copy()
    const void* wait_for_bytes(Stream& stream);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
