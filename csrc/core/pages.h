// Files that are mapped into memory, whose pages are let go of where the process would hold too much.
#pragma once

#include <cstdint>
#include <memory>

namespace mipbake {

// Whether this system has what it takes; nothing of the class is to be called elsewhere.
bool pages_supported();

// Bytes that the process holds in memory now, pages of files among them. 0 where the system does not tell.
std::int64_t resident_bytes();

// A thread looks at what the process holds, every thousandth of a second. What is written to a page stays in the file
// when the page is let go of, and comes back when the page is next touched.
class Pages {
  public:
    // Pages are let go of where the process holds more than `most` bytes.
    explicit Pages(std::int64_t most);
    ~Pages();  // ends the thread; mappings stay until nobody holds them

    // The whole of a file, which may be closed after that; null where the system refuses, with the reason in errno.
    std::shared_ptr<void> map(int file, std::int64_t bytes);

    // Lets go of every page.
    void release();

  private:
    struct Shared;
    std::shared_ptr<Shared> shared_;
};

}  // namespace mipbake
