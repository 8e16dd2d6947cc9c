// SPDX-License-Identifier: Apache-2.0
// Device memory and kernel submission without Vulkan types, so that other parts of
// relidar can allocate arrays and run kernels.
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

/// Block of device memory. Move-only.
class Buffer {
public:
    Buffer();
    /// Allocates n_bytes of device memory.
    /// @param what name of the buffer in messages
    /// @throws DeviceError if device memory is exhausted; the message names the buffer
    /// and its size
    Buffer(Device& device, std::size_t n_bytes, const std::string& what);
    ~Buffer();
    Buffer(Buffer&&) noexcept;
    Buffer& operator=(Buffer&&) noexcept;

    std::size_t size_bytes() const;
    explicit operator bool() const { return impl_ != nullptr; }
    /// Copies between host and device through staging memory, and blocks until the copy
    /// is done.
    /// @throws DeviceError if the device is lost
    void upload(const void* data, std::size_t n_bytes, std::size_t offset_bytes = 0);
    void download(void* data, std::size_t n_bytes, std::size_t offset_bytes = 0) const;
    /// Copies the first n_bytes of another buffer of the same device, and blocks until
    /// the copy is done.
    void copy_from(const Buffer& source, std::size_t n_bytes);

    struct Impl;

private:
    /// Returns the internal implementation; used only inside the library.
    friend Impl& impl_of(const Buffer& buffer);
    template <class, class>
    friend class Array;
    std::unique_ptr<Impl> impl_;

    std::uint64_t address() const;
};

/// Device array of trivially copyable values.
template <class T>
class Array<T, void> {
public:
    Array() = default;
    Array(Device& device, std::size_t n, const std::string& what)
        : buffer_(device, (n ? n : 1) * sizeof(T), what), n_(n) {}
    Array(Device& device, std::span<const T> values, const std::string& what)
        : Array(device, values.size(), what) {
        upload(values);
    }

    std::size_t size() const { return n_; }
    /// Returns the device address of entry `first`, to pass to a kernel. Arrays start at
    /// multiples of 16 bytes, so that kernels can load a record in 16-byte pieces. An
    /// address that is not a multiple of 16 bytes may only be used with atomics or with
    /// indices computed at run time.
    Address<T> address(std::size_t first = 0) const { return address_as<T>(first); }
    /// Returns the same address for a kernel that reads the memory as another type or
    /// meaning. `first` counts entries of T.
    template <class U, class Meaning = void>
    Address<U, Meaning> address_as(std::size_t first = 0) const {
        static_assert(sizeof(T) % sizeof(U) == 0 || sizeof(U) % sizeof(T) == 0);
        return Address<U, Meaning>(buffer_.address() + first * sizeof(T));
    }
    const Buffer& buffer() const { return buffer_; }
    void upload(std::span<const T> values, std::size_t first = 0) {
        if (!values.empty()) buffer_.upload(values.data(), values.size_bytes(), first * sizeof(T));
    }
    std::vector<T> download() const { return download(n_); }
    /// Copies the first n values to the host.
    std::vector<T> download(std::size_t n) const {
        std::vector<T> values(n);
        if (n) buffer_.download(values.data(), n * sizeof(T));
        return values;
    }
    /// Grows the array to at least n values and keeps the existing values; new values are
    /// undefined. The array never shrinks. No pending submission may use the array,
    /// because its address changes.
    /// @throws DeviceError if device memory is exhausted; the array is then unchanged
    void reserve(Device& device, std::size_t n, const std::string& what) {
        if (n <= n_) return;
        Array larger(device, n, what);
        if (n_) larger.buffer_.copy_from(buffer_, n_ * sizeof(T));
        *this = std::move(larger);
    }

private:
    Buffer buffer_;
    std::size_t n_ = 0;
};

/// Device array whose type also names its content. The Meaning is a name that a kernel
/// parameter declares with RELIDAR_OF, for example Array<float, shared::LossTerms>. It
/// separates arrays of the same element type. On the host it behaves like Array<T>.
template <class T, class Meaning>
class Array : public Array<T> {
public:
    using Array<T>::Array;
    /// Returns the device address of an element. The address has the same Meaning.
    Address<T, Meaning> address(std::size_t first = 0) const {
        return this->template address_as<T, Meaning>(first);
    }
};

/// Returns the address of an optional array, or a null address if the pointer is null.
template <class T, class Meaning>
Address<T, Meaning> address_of(const Array<T, Meaning>* array) {
    return array ? array->address() : Address<T, Meaning>();
}

/// Records kernel launches and submits them. A launch sees the results of all earlier
/// launches, except launches in the same Concurrent scope or in another strand (see
/// Strands).
class Stream {
public:
    explicit Stream(Device& device, bool timing = false);
    ~Stream();
    Stream(const Stream&) = delete;
    Stream& operator=(const Stream&) = delete;

    /// Fills an array with a 32-bit pattern.
    void fill(const Buffer& buffer, std::uint32_t pattern = 0);
    template <class T>
    void fill(const Array<T>& array, std::uint32_t pattern = 0) {
        fill(array.buffer(), pattern);
    }
    /// Records a copy of the first n_bytes of one buffer to another buffer of the same
    /// device.
    void copy(const Buffer& from, const Buffer& to, std::size_t n_bytes);
    /// Submits the recorded commands.
    /// @return ticket for wait()
    std::uint64_t submit();
    /// Blocks until the submission with this ticket is done.
    /// @throws DeviceError if the device is lost or a check in a kernel failed; the
    /// message names the kernel
    void wait(std::uint64_t ticket);
    /// Submits the recorded commands and waits for them.
    void finish() { wait(submit()); }
    /// Returns the kernel times measured so far. Requires timing = true and a device with
    /// timestamps.
    const KernelTimes& times() const;
    void reset_times();
    Device& device() const;

    struct Impl;

private:
    /// Returns the internal implementation; used only inside the library.
    friend Impl& impl_of(const Stream& stream);
    std::unique_ptr<Impl> impl_;
};

/// Scope in which all launches recorded on a stream may run concurrently. A launch may
/// not access memory that another launch of the scope writes. Commands recorded after the
/// scope see the results of all its launches.
class Concurrent {
public:
    explicit Concurrent(Stream& stream);
    ~Concurrent();
    Concurrent(const Concurrent&) = delete;
    Concurrent& operator=(const Concurrent&) = delete;

private:
    Stream& stream_;
};

/// Scope in which a stream records into several independent sequences of launches, called
/// strands. A launch sees the results of earlier launches of the same strand. The n-th
/// launches of all strands may run concurrently, so that small launches fill a device
/// together. No launch may access memory that another strand writes. Commands recorded or
/// submitted after the scope see the results of all strands.
class Strands {
public:
    Strands(Stream& stream, std::size_t n);
    ~Strands();
    Strands(const Strands&) = delete;
    Strands& operator=(const Strands&) = delete;
    /// Selects the strand of all launches recorded from here on. Initially strand 0.
    void choose(std::size_t strand);

private:
    Stream& stream_;
};

/// Copy of device values to the host that is executed with a later submission.
class Readback {
public:
    /// Allocates host memory for the copy.
    /// @param n_bytes maximum size of a copy
    /// @param what name of the copy in messages
    /// @throws DeviceError if memory is exhausted
    Readback(Device& device, std::size_t n_bytes, const std::string& what);
    ~Readback();
    Readback(Readback&&) noexcept;
    Readback& operator=(Readback&&) noexcept;

    /// Records a copy of n_bytes into cached host memory. The next submit() of the stream
    /// executes the copy.
    void record(Stream& stream, const Buffer& from, std::size_t n_bytes, std::size_t offset_bytes = 0);
    /// Returns true if a copy was recorded and wait() has not yet been called for it.
    bool pending() const;
    /// Blocks until the recorded copy is done.
    /// @return the copied bytes, valid until the next record()
    const void* wait(Stream& stream);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
