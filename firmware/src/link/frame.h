/* frame - the block format: COBS and CRC-32. Pure. */
#ifndef FRAME_H
#define FRAME_H
#include <stdint.h>

/* crc32 of zlib, continued from crc (start with 0). */
uint32_t frame_crc32(uint32_t crc, const uint8_t *data, uint8_t size);

/* Decode in place; the length of the result, or 0 if it is not COBS. */
uint8_t frame_cobs_decode(uint8_t *data, uint8_t size);

/* Encode without the closing zero; out needs size + 1 bytes (size <= 253). Returns the encoded length. */
uint8_t frame_cobs_encode(const uint8_t *data, uint8_t size, uint8_t *out);

/* Decode and check one received block. Returns 1 and leaves length, sequence, type, body in data; else 0. */
uint8_t frame_open(uint8_t *data, uint8_t size);

/* Close the block in data (length, sequence, type, body): appends the CRC. Returns its whole length. */
uint8_t frame_close(uint8_t *data);
#endif
