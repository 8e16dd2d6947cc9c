// SPDX-License-Identifier: Apache-2.0
// Device memory and submission, without a Vulkan type: what a stage needs to own arrays
// and run kernels on them.
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

/// A piece of device memory. Move-only.
class Buffer {
public:
    Buffer();
    /// @param what  name used in messages @throws DeviceError where memory is exhausted,
    /// with size and what was asked for
    Buffer(Device& device, std::size_t n_bytes, const std::string& what);
    ~Buffer();
    Buffer(Buffer&&) noexcept;
    Buffer& operator=(Buffer&&) noexcept;

    std::size_t size_bytes() const;
    explicit operator bool() const { return impl_ != nullptr; }
    /// Blocking copies through staging memory. @throws DeviceError on a lost device
    void upload(const void* data, std::size_t n_bytes, std::size_t offset_bytes = 0);
    void download(void* data, std::size_t n_bytes, std::size_t offset_bytes = 0) const;
    /// Blocking copy of the first bytes of another buffer of the same device.
    void copy_from(const Buffer& source, std::size_t n_bytes);

    struct Impl;

private:
    friend Impl& impl_of(const Buffer& buffer);  ///< what the library itself works with
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
    /// What kernels are given: the whole array, or the part of it that begins at an
    /// entry. Arrays begin at multiples of 16 bytes, so that kernels load a record in
    /// pieces of 16 bytes; a part that begins elsewhere is indexed at run time, or by
    /// atomics, and nothing else.
    Address<T> address(std::size_t first = 0) const { return address_as<T>(first); }
    /// The same memory for a kernel that takes it for entries of another type or meaning.
    /// `first` counts entries of T.
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
    /// The first n values.
    std::vector<T> download(std::size_t n) const {
        std::vector<T> values(n);
        if (n) buffer_.download(values.data(), n * sizeof(T));
        return values;
    }
    /// Makes room for n values and keeps those there are; the rest is undefined. Never
    /// shrinks. Nothing may be in flight that uses the array: it moves. @throws
    /// DeviceError where memory is exhausted; the array is then as before
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

/// Device array of which kernels that take several of its type know what it holds: the
/// Meaning is the name that their parameters give by RELIDAR_OF, as in Array<float,
/// shared::LossTerms>. For all others, and on the host, it is an Array<T>.
template <class T, class Meaning>
class Array : public Array<T> {
public:
    using Array<T>::Array;
    Address<T, Meaning> address(std::size_t first = 0) const {
        return this->template address_as<T, Meaning>(first);
    }
};

/// Of an array that need not be there: null is nowhere.
template <class T, class Meaning>
Address<T, Meaning> address_of(const Array<T, Meaning>* array) {
    return array ? array->address() : Address<T, Meaning>();
}

/// Records kernels and submits them. Each launch sees the results of all earlier ones,
/// but of those in its Concurrent scope or in other Strands.
class Stream {
public:
    explicit Stream(Device& device, bool timing = false);
    ~Stream();
    Stream(const Stream&) = delete;
    Stream& operator=(const Stream&) = delete;

    /// Sets an array to a 32-bit pattern.
    void fill(const Buffer& buffer, std::uint32_t pattern = 0);
    template <class T>
    void fill(const Array<T>& array, std::uint32_t pattern = 0) {
        fill(array.buffer(), pattern);
    }
    /// Copies the first n_bytes of one buffer to another of the same device.
    void copy(const Buffer& from, const Buffer& to, std::size_t n_bytes);
    /// Submits what was recorded. @return a ticket for wait()
    std::uint64_t submit();
    /// Blocks until a ticket is done. @throws DeviceError on a lost device or a
    /// device-side check, with the kernel's name
    void wait(std::uint64_t ticket);
    /// submit and wait.
    void finish() { wait(submit()); }
    /// Times measured so far (only with timing = true and a device with timestamps).
    const KernelTimes& times() const;
    void reset_times();
    Device& device() const;

    struct Impl;

private:
    friend Impl& impl_of(const Stream& stream);  ///< what the library itself works with
    std::unique_ptr<Impl> impl_;
};

/// While it lives, what a stream records may run at the same time: no launch may read or
/// write what another one of the scope writes. What is recorded afterwards sees the
/// results of all of them.
class Concurrent {
public:
    explicit Concurrent(Stream& stream);
    ~Concurrent();
    Concurrent(const Concurrent&) = delete;
    Concurrent& operator=(const Concurrent&) = delete;

private:
    Stream& stream_;
};

/// While it lives, a stream records into strands. A launch sees the results of the
/// earlier ones of its own strand; the n-th launches of all strands may run at the same
/// time, so that small ones fill a device together. No launch may read or write what
/// another strand writes. What is recorded or submitted afterwards sees the results of
/// all of them.
class Strands {
public:
    Strands(Stream& stream, std::size_t n);
    ~Strands();
    Strands(const Strands&) = delete;
    Strands& operator=(const Strands&) = delete;
    /// What is recorded from now on belongs to this one, at first to 0.
    void choose(std::size_t strand);

private:
    Stream& stream_;
};

/// A copy of device values that arrives with a later submission.
class Readback {
public:
    /// @param n_bytes at most in one copy @param what name used in messages @throws
    /// DeviceError where memory is exhausted
    Readback(Device& device, std::size_t n_bytes, const std::string& what);
    ~Readback();
    Readback(Readback&&) noexcept;
    Readback& operator=(Readback&&) noexcept;

    /// Records a copy of n_bytes into cached host memory. The next submit() of the stream
    /// sends it.
    void record(Stream& stream, const Buffer& from, std::size_t n_bytes, std::size_t offset_bytes = 0);
    /// A copy was recorded that wait() has not been called for.
    bool pending() const;
    /// Blocks until the recorded copy is done. @return the bytes, valid until the next
    /// record()
    const void* wait(Stream& stream);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
