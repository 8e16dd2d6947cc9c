// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>

#include <stdlib.h>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>

namespace relidar {

struct ScratchFolder {
    std::filesystem::path path;

    ScratchFolder() {
        std::string pattern = (std::filesystem::temp_directory_path() / "relidar-test-XXXXXX").string();
        if (::mkdtemp(pattern.data())) path = pattern;
    }
    ~ScratchFolder() { std::filesystem::remove_all(path); }
    ScratchFolder(const ScratchFolder&) = delete;
    ScratchFolder& operator=(const ScratchFolder&) = delete;
};

class TemporaryFolder : public testing::Test {
protected:
    void SetUp() override { ASSERT_FALSE(folder.empty()); }

    std::vector<std::string> files() const {
        std::vector<std::string> names;
        for (const auto& entry : std::filesystem::directory_iterator(folder))
            names.push_back(entry.path().filename());
        return names;
    }

    ScratchFolder scratch;
    const std::filesystem::path folder = scratch.path;
};

inline std::string read_contents(const std::filesystem::path& path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

template <class T>
T read_at(const std::string& bytes, std::size_t offset) {
    T value{};
    std::memcpy(&value, bytes.data() + offset, sizeof value);
    return value;
}

inline void put(const std::filesystem::path& path, std::string_view bytes) {
    // Deletes the file first, because ext4 flushes a file to disk if it is truncated and
    // rewritten, which is slow.
    std::filesystem::remove(path);
    std::ofstream(path, std::ios::binary).write(bytes.data(), std::streamsize(bytes.size()));
}

template <class ExpectedError, class Call>
std::string error_message(const Call& call) {
    try {
        call();
    } catch (const ExpectedError& error) {
        const std::string message = error.what();
        EXPECT_EQ(message.find('\n'), std::string::npos) << "more than one line: " << message;
        return message;
    } catch (const std::exception& error) {
        ADD_FAILURE() << "threw something else: " << error.what();
        return "";
    }
    ADD_FAILURE() << "threw nothing";
    return "";
}
template <class Call>
std::string get_data_error_message(const Call& call) {
    return error_message<DataError>(call);
}

}  // namespace relidar
