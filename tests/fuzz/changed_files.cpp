// SPDX-License-Identifier: Apache-2.0
#include "changed_files.hpp"

#include <utility>

#include "harness.hpp"

namespace relidar::fuzz {

ChangedFiles::ChangedFiles(std::vector<std::filesystem::path> files) : files_(std::move(files)) {
    for (const std::filesystem::path& file : files_) usual_.push_back(read_contents(file));
}

/// Writes the usual content of the changed files.
struct ChangedFiles::Restore {
    const ChangedFiles& all;
    std::vector<std::size_t> changed = {};

    ~Restore() {
        for (const std::size_t file : changed) put(all.files_[file], all.usual_[file]);
    }
};

void ChangedFiles::read(std::string_view input, const std::function<void(unsigned options)>& read) const {
    Restore restore{*this};
    for (std::size_t at = 1; at + 3 <= input.size();) {
        const auto byte = [&](std::size_t index) {
            return static_cast<std::size_t>(static_cast<unsigned char>(input[index]));
        };
        const std::size_t file = byte(at) % files_.size(), length = byte(at + 1) + 256 * byte(at + 2);
        const std::string_view bytes = input.substr(at + 3, length);
        restore.changed.push_back(file);
        put(files_[file], bytes);
        at += 3 + bytes.size();
    }
    read(input.empty() ? 0u : static_cast<unsigned char>(input[0]));
}

std::vector<std::string> ChangedFiles::seeds(const std::vector<unsigned>& alone,
                                             const std::vector<unsigned>& with_a_file) const {
    std::vector<std::string> seeds;
    for (const unsigned options : alone) seeds.emplace_back(1, static_cast<char>(options));
    for (std::size_t file = 0; file < files_.size(); ++file) {
        const std::string bytes = usual_[file].substr(0, 4096);
        const std::string section = std::string(1, static_cast<char>(file)) +
                                    static_cast<char>(bytes.size() % 256) +
                                    static_cast<char>(bytes.size() / 256) + bytes;
        for (const unsigned options : with_a_file) seeds.push_back(static_cast<char>(options) + section);
    }
    return seeds;
}

void ChangedFiles::read_one(std::string_view input, const std::function<void()>& read) const {
    if (input.empty()) return;
    const Restore restore{*this, {static_cast<unsigned char>(input[0]) % files_.size()}};
    put(files_[restore.changed[0]], input.substr(1));
    read();
}

std::vector<std::string> ChangedFiles::make_seeds_of_one() const {
    std::vector<std::string> seeds;
    for (std::size_t file = 0; file < files_.size(); ++file)
        seeds.push_back(static_cast<char>(file) + usual_[file]);
    return seeds;
}

}  // namespace relidar::fuzz
