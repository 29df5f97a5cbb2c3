#include "frame.h"

#include "protocol.h"
#include "board/flash.h"

/* A kilobyte of flash: with a smaller table the longest report costs more time than a step at full speed leaves. */
static const uint32_t table[256] IN_FLASH = {
#include "crc_table.inc"
};

uint32_t frame_crc32(uint32_t crc, const uint8_t *data, uint8_t size)
{
    crc = ~crc;
    while (size--)
        crc = (crc >> 8) ^ flash_u32(&table[(uint8_t)crc ^ *data++]);
    return ~crc;
}

uint8_t frame_cobs_decode(uint8_t *data, uint8_t size)
{
    uint8_t in = 0, out = 0;

    while (in < size) {
        uint8_t code = data[in++];
        if (code == 0 || code - 1 > size - in)
            return 0;
        for (uint8_t i = 1; i < code; i++)
            data[out++] = data[in++];
        if (code < 0xFF && in < size)
            data[out++] = 0;
    }
    return out;
}

uint8_t frame_cobs_encode(const uint8_t *data, uint8_t size, uint8_t *out)
{
    uint8_t code_at = 0, used = 1, code = 1;

    for (uint8_t i = 0; i < size; i++) {
        if (data[i]) {
            out[used++] = data[i];
            code++;
        } else {
            out[code_at] = code;
            code_at = used++;
            code = 1;
        }
    }
    out[code_at] = code;
    return used;
}

static uint32_t read_u32(const uint8_t *at)
{
    return at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

uint8_t frame_open(uint8_t *data, uint8_t size)
{
    uint8_t length = frame_cobs_decode(data, size);

    if (length < BLOCK_OVERHEAD || data[0] != length - BLOCK_OVERHEAD)
        return 0;
    return frame_crc32(0, data, length - 4) == read_u32(data + length - 4);
}

uint8_t frame_close(uint8_t *data)
{
    uint8_t length = data[0] + BLOCK_OVERHEAD - 4;
    uint32_t crc = frame_crc32(0, data, length);

    for (uint8_t i = 0; i < 4; i++, crc >>= 8)
        data[length++] = (uint8_t)crc;
    return length;
}
