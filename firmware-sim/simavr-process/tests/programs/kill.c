/* Sets D7 to each byte. */
#include "uart.h"

int main(void)
{
	uart_begin();
	DDRD |= 1 << 7;
	for (;;) {
		if (uart_receive())
			PORTD |= 1 << 7;
		else
			PORTD &= ~(1 << 7);
	}
}
