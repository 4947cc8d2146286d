/*
 * A master of the two-wire interface, controlled by the host. Commands:
 *   's'    start condition         'p'      stop condition
 *   'w' b  sends a byte            'r' a    receives one, acknowledges if a
 *   'c'    nine pulses on the clock line by software
 * All but 'p' answer with the status, 'r' with the byte after it. A start that
 * takes more than a millisecond is aborted: status 0xFF.
 */
#include "uart.h"
#include <util/delay.h>

static void act(uint8_t bits)
{
	TWCR = 1 << TWINT | 1 << TWEN | bits;
	for (uint16_t i = 0; i < 2000; i++)
		if (TWCR & 1 << TWINT) {
			uart_send(TWSR & 0xF8);
			return;
		}
	TWCR = 0;
	uart_send(0xFF);
}

int main(void)
{
	uart_begin();
	TWBR = 72;
	for (;;)
		switch (uart_receive()) {
		case 's':
			act(1 << TWSTA);
			break;
		case 'p':
			TWCR = 1 << TWINT | 1 << TWEN | 1 << TWSTO;
			while (TWCR & 1 << TWSTO)
				;
			break;
		case 'w':
			TWDR = uart_receive();
			act(0);
			break;
		case 'r':
			act(uart_receive() ? 1 << TWEA : 0);
			uart_send(TWDR);
			break;
		case 'c':
			for (uint8_t i = 0; i < 9; i++) {
				DDRC |= 1 << 5;
				_delay_us(5);
				DDRC &= ~(1 << 5);
				_delay_us(5);
			}
			uart_send(PINC & 1 << 4);
			break;
		}
}
